"""What a head was taught about its parts stays with them when they are renamed or copied."""

import bpy
import numpy as np
import pytest

from facemime.blender.characters import members_of
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import mesh_of
from facemime.blender.names import ORDER_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.blender.styles import write_example
from facemime.core.heads.style import N_FEATURES, Example


@pytest.fixture
def bearded():
    """A head with three parts on its skin that have different numbers of vertices."""
    head = add_head(bpy.context)
    for number, name in enumerate(["Beard", "Moustache", "Moustache.001"]):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(0.01 * number, -0.1, 0.01 * row) for row in range(5 + number)], [], [(0, 1, 2)])
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))
    for obj in bpy.context.scene.objects:
        obj.select_set(obj == head or obj.name.startswith(("Beard", "Moustache")))
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.add_part(part="ON_SKIN") == {"FINISHED"}
    return head


def teach(head):
    """Teach that the beard, which has five vertices, moves."""
    offsets = np.zeros((members_of(head)[-1].part.stop, 3), dtype=np.float32)
    (part,) = (member.part for member in members_of(head) if len(mesh_of(member.obj).vertices) == 5)
    offsets[part] = 1.0
    write_example(head, Example("Beard", "", np.zeros(N_FEATURES), offsets))


def taught(head):
    """The numbers of vertices of the parts that the example moves."""
    (example,) = read_rig(head).style.examples
    moved = [member for member in members_of(head) if example.offsets[member.part].any()]
    assert all(example.offsets[member.part].all() for member in moved)
    return [len(mesh_of(member.obj).vertices) for member in moved]


@pytest.mark.parametrize("name", ["A", "N", "Z"])
def test_examples_move_the_same_part_after_it_was_renamed(bearded, name):
    teach(bearded)
    assert taught(bearded) == [5]
    bpy.data.objects["Beard"].name = name
    assert taught(bearded) == [5]


def test_examples_of_a_copy_move_the_same_part_whatever_the_copies_are_called(bearded):
    teach(bearded)
    before = set(bpy.data.objects)
    for obj in bpy.context.scene.objects:
        obj.select_set(True)
    bpy.ops.object.duplicate()
    copies = [obj for obj in bpy.data.objects if obj not in before and obj.type == "MESH"]
    for number, obj in enumerate(copies):
        obj.name = f"{number * 7 % 10} Copy"
    (head,) = (obj for obj in copies if "facemime_landmarks" in mesh_of(obj))
    assert taught(head) == [5] and taught(bearded) == [5]


def test_parts_that_are_added_later_come_after_those_that_were_taught(bearded):
    teach(bearded)
    order = [member.obj for member in members_of(bearded)]
    mesh = bpy.data.meshes.new("Added")
    mesh.from_pydata([(0.0, -0.1, 0.01 * row) for row in range(9)], [], [(0, 1, 2)])
    added = bpy.data.objects.new("Added", mesh)
    bpy.context.scene.collection.objects.link(added)
    for obj in bpy.context.scene.objects:
        obj.select_set(obj in (added, bearded))
    bpy.ops.facemime.add_part(part="ON_SKIN")
    assert [member.obj for member in members_of(bearded)] == [*order, added]
    assert bpy.ops.facemime.remove_part(name="Beard") == {"FINISHED"}
    assert ORDER_PROPERTY not in bpy.data.objects["Beard"]


def test_parts_of_earlier_files_can_be_renamed_once_opened(bearded, tmp_path):
    teach(bearded)
    for obj in bpy.data.objects:
        obj.pop(ORDER_PROPERTY, None)
    name = bearded.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "earlier.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "earlier.blend"))
    bpy.data.objects["Beard"].name = "Z"
    assert taught(bpy.data.objects[name]) == [5]
