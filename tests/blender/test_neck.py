"""A character with a body and no bones turns its head on a neck, and its body stays where it is."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.characters import read_bones
from facemime.blender.controls.face_rig import add_face_rig
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.family import armature_of
from facemime.blender.heads.neck import give_neck, remove_neck
from facemime.blender.heads.new_heads import add_head
from facemime.blender.heads.placing import FormerBinding
from facemime.blender.meshes import mesh_of, read_landmarks
from facemime.core.face.landmarks import CHIN
from tests.helpers.characters import make_character, shown
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

TURN = Matrix.Rotation(0.5, 3, "Z")


@pytest.fixture
def figure():
    """A head and its body as one mesh, and its hair as another, without bones; where each vertex is."""
    objects = make_character(rig=False, hair=True)
    with bpy.context.temp_override(
        active_object=objects["head"], selected_editable_objects=[objects["head"], objects["body"]]
    ):
        bpy.ops.object.join()
    objects["hair"].parent = objects["head"]
    head, _ = bind_character(objects["head"])
    return head, objects["hair"]


def names(head):
    return [group.name for group in head.vertex_groups], [modifier.name for modifier in head.modifiers]


def turned(head):
    """Where the vertices of a head are if its bone turns it."""
    armature, bones = read_bones(head)
    bone = armature.pose.bones[bones.head]
    axes = bone.bone.matrix_local.to_3x3()
    bone.matrix_basis = (axes.inverted() @ TURN @ axes).to_4x4()
    bpy.context.view_layer.update()
    places = shown(head)
    bone.matrix_basis = Matrix.Identity(4)
    bpy.context.view_layer.update()
    return places


def test_the_head_turns_as_a_whole_and_the_body_stays(figure):
    head, hair = figure
    before = shown(head), shown(hair)
    assert "Neck turns the head" in give_neck(head)
    np.testing.assert_allclose(shown(head), before[0], atol=1e-6)
    places = turned(head)
    face = read_landmarks(head)
    pivot = np.array(read_bones(head)[0].matrix_world @ read_bones(head)[0].data.bones["Head"].head_local)
    rigid = (before[0][face] - pivot) @ np.array(TURN).T + pivot
    np.testing.assert_allclose(places[face], rigid, atol=1e-4)
    low = before[0][:, 2] < before[0][face[CHIN], 2].min() - 0.1
    assert low.any()
    np.testing.assert_allclose(places[low], before[0][low], atol=1e-6)
    assert hair.find_armature() == armature_of(head)


def test_the_pose_of_a_performance_goes_to_the_bone(figure):
    head, _ = figure
    give_neck(head)
    puppet_head(bpy.context.scene, head, performance(), targets=own_targets(head))
    assert any("rotation" in curve.data_path for curve in curves_of(armature_of(head)))
    assert head.animation_data is None


@pytest.mark.parametrize("parent", first_of([False, True]))
def test_a_neck_can_be_removed_without_a_trace(figure, parent):
    head, hair = figure
    if parent:
        head.parent = bpy.data.objects.new("Root", None)
        bpy.context.scene.collection.objects.link(head.parent)
        head.parent.location = 1.0, 2.0, 3.0
        bpy.context.view_layer.update()
    own, above = names(head), head.parent
    before, world = shown(head), head.matrix_world.copy()
    give_neck(head)
    remove_neck(armature_of(head))
    bpy.context.view_layer.update()
    assert armature_of(head) is None and head.parent == above and not read_bones(head)[1].head
    assert names(head) == own and not hair.modifiers
    np.testing.assert_allclose(shown(head), before, atol=1e-6)
    np.testing.assert_allclose(np.array(head.matrix_world), np.array(world), atol=1e-6)
    assert not bpy.data.armatures


@pytest.mark.thorough
def test_going_back_to_the_former_binding_removes_the_neck(figure):
    head, _ = figure
    former = FormerBinding(bpy.context)
    give_neck(head)
    former.restore(bpy.context)
    assert armature_of(head) is None and own_targets(head)["head"].owner == head


@pytest.mark.thorough
def test_vertex_groups_of_the_same_names_are_left_alone(figure):
    head, _ = figure
    own = head.vertex_groups.new(name="Head")
    own.add([0, 1, 2], 0.25, "REPLACE")
    give_neck(head)
    places = turned(head)
    assert read_bones(head)[1].head == "Head.001" and not np.allclose(places, shown(head))
    remove_neck(armature_of(head))
    assert "Head.001" not in head.vertex_groups
    assert [head.vertex_groups["Head"].weight(vertex) for vertex in (0, 1, 2)] == [0.25] * 3


def test_a_neck_of_a_face_elsewhere_is_replaced_and_one_that_fits_is_kept(figure):
    head, _ = figure
    give_neck(head)
    armature = armature_of(head)
    assert not give_neck(head) and armature_of(head) == armature
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones["Head"].translate(Vector((0.0, 0.0, -0.1)))
    bpy.ops.object.mode_set(mode="OBJECT")
    assert give_neck(head)
    assert len([modifier for modifier in head.modifiers if modifier.type == "ARMATURE"]) == 1
    assert len(bpy.data.armatures) == 1


def test_a_head_without_a_body_or_with_bones_needs_none():
    assert not give_neck(add_head(bpy.context))
    rigged, _ = bind_character(make_character(rig=True)["head"])
    armature = armature_of(rigged)
    assert not give_neck(rigged) and armature_of(rigged) == armature


@pytest.mark.thorough
def test_a_face_rig_replaces_the_neck(figure):
    head, _ = figure
    give_neck(head)
    bpy.ops.preferences.addon_enable(module="rigify")
    armature = add_face_rig(head)
    assert armature_of(head) == armature
    assert len(mesh_of(head).vertices) and "Neck" not in head.modifiers
