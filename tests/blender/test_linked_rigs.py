"""Characters with learnt controls that are linked from another file, and their library overrides."""

import bpy
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import read_controls, write_controls
from facemime.blender.meshes import mesh_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.sessions.show import TakeShow
from tests.helpers.face_rigs import make_face_rig, state
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def linked(tmp_path):
    """The collection of a character with learnt controls, linked into a new file."""
    head, _ = make_face_rig()
    write_controls(head, learn_controls(head))
    collection = bpy.data.collections.new("Character")
    for obj in list(bpy.context.scene.objects):
        collection.objects.link(obj)
    bpy.context.scene.collection.children.link(collection)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 25
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, chosen):
        chosen.collections = ["Character"]
    bpy.context.scene.collection.children.link(chosen.collections[0])
    return chosen.collections[0]


def head_in(collection):
    return next(obj for obj in collection.all_objects if obj.type == "MESH" and "facemime_landmarks" in mesh_of(obj))


def overridden(collection):
    """The head of a library override of a character, and its armature."""
    layer = bpy.context.view_layer
    own = collection.override_hierarchy_create(bpy.context.scene, layer, do_fully_editable=True)
    layer.objects.active = head_in(own)
    layer.update()
    return head_in(own), next(obj for obj in own.all_objects if obj.type == "ARMATURE")


def bake(head):
    return puppet_head(
        bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(keys="controls"), neutral=0.0)
    )


def test_a_linked_rig_says_that_it_needs_an_override(linked):
    head = bpy.context.view_layer.objects.active = head_in(linked)
    with pytest.raises(RuntimeError, match="Make a library override of it"):
        bpy.ops.facemime.learn_controls()
    with pytest.raises(HeadError, match="Make a library override of it"):
        bake(head)


def test_an_override_is_previewed_and_baked_with_the_controls_of_its_file(linked):
    head, armature = overridden(linked)
    before = state(armature)
    bpy.context.scene.facemime.drive_by = "CONTROLS"
    shown = TakeShow(bpy.context.scene, [head], performance())
    bpy.context.scene.frame_set(40)
    assert state(armature)["c5"] != before["c5"]
    shown.close()
    assert state(armature)["c5"] == before["c5"]
    assert bake(head).controls == len(read_controls(head).controls)
    assert armature.animation_data.action.library is None


def test_an_override_keeps_which_controls_are_used_and_refuses_to_learn(linked, tmp_path):
    head, _ = overridden(linked)
    with pytest.raises(RuntimeError, match="Learn them in its own file"):
        bpy.ops.facemime.learn_controls()
    head.facemime_rig.controls["Hinge"].use = False
    name = head.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    head = bpy.data.objects[name, None]
    assert not head.facemime_rig.controls["Hinge"].use and "Hinge" not in read_controls(head).controls


@pytest.mark.thorough
def test_a_second_override_is_moved_by_its_own_controls_also_when_the_file_is_opened_again(linked, tmp_path):
    _, first = overridden(linked)
    head, second = overridden(linked)
    for again in (False, True):
        if again:
            names = first.name, head.name, second.name
            bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
            bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
            first, head, second = (bpy.data.objects[name, None] for name in names)
        before = state(first)
        assert bake(head).controls == len(read_controls(head).controls)
        assert second.animation_data.action and state(first) == before
        assert first.animation_data is None or first.animation_data.action is None
