"""Changes to the scene while a puppet is running: saving, deleting, renaming, Edit Mode, copies; linked heads."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.exporting import MODIFIER
from facemime.blender.animation.live import LiveHeadObject
from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.heads.new_heads import add_head
from facemime.core.errors import HeadError
from facemime.operators.puppet import running
from tests.helpers.live_ticks import outcome_of_ticks, shown, some_frames, start, ticks_until

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def test_saving_during_a_session_writes_the_head_at_rest(looping, tmp_path):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "head.blend"))
    before = running()._number
    ticks_until(lambda: running()._number > before)
    assert LIVE_KEY in head.data.shape_keys.key_blocks
    bpy.ops.facemime.stop_puppet()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "head.blend"))
    again = bpy.data.objects["Facemime Head"]
    assert again.data.shape_keys is None
    np.testing.assert_array_equal(shown(again), rest)


def test_renaming_the_head_or_changing_the_active_object_has_no_effect(looping):
    head = add_head(bpy.context)
    start()
    head.name = "Somebody"
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.active_object
    some_frames()
    assert cube.data.shape_keys is None and LIVE_KEY in head.data.shape_keys.key_blocks


def test_a_running_puppet_follows_the_settings_of_its_scene_when_that_is_renamed(looping):
    add_head(bpy.context)
    start()
    scene = bpy.context.scene
    bpy.data.scenes.new("Other")
    scene.name, bpy.data.scenes["Other"].name = "Renamed", scene.name
    scene.facemime.smoothing = 3.0
    some_frames()
    assert running().worker.options.smoothing == 3.0


def test_a_head_pauses_in_edit_mode_and_a_changed_mesh_is_reported(looping):
    head = add_head(bpy.context)
    start()
    bpy.ops.object.mode_set(mode="EDIT")
    some_frames()
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    head.data.vertices[5].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None


def test_copies_are_at_rest_and_hiding_and_changing_the_scene_have_no_effect(looping):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    some_frames()
    np.testing.assert_array_equal(shown(copy), rest)
    assert np.allclose(copy.delta_rotation_euler, 0.0) and np.abs(shown(head) - rest).max() > 1e-4
    head.hide_set(True)
    first = bpy.context.scene
    bpy.context.window.scene = bpy.data.scenes.new("Other")
    some_frames()
    bpy.context.window.scene = first
    head.hide_set(False)
    np.testing.assert_array_equal(shown(copy), rest)
    bpy.ops.facemime.stop_puppet()
    assert head.data.shape_keys is None and copy.data.shape_keys is None


def test_linked_heads_are_rejected_with_a_remedy(take, tmp_path):
    add_head(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, loaded):
        loaded.objects = ["Facemime Head"]
    with pytest.raises(HeadError, match="Make Local"):
        LiveHeadObject(loaded.objects[0], {})


def test_solo_active_shape_key_and_a_disabled_cache_are_restored(looping):
    head = add_head(bpy.context, units=True)
    cache = head.modifiers.new(MODIFIER, "MESH_CACHE")
    head.show_only_shape_key, head.active_shape_key_index, cache.show_render = True, 3, False
    start()
    rest = shown(add_head(bpy.context))
    assert np.abs(shown(head) - rest).max() > 1e-3
    bpy.ops.facemime.stop_puppet()
    assert head.show_only_shape_key and head.active_shape_key_index == 3
    assert cache.show_viewport and not cache.show_render


def test_absolute_shape_keys_are_rejected(take):
    head = add_head(bpy.context, units=True)
    head.data.shape_keys.use_relative = False
    with pytest.raises(RuntimeError, match="Enable Relative"):
        bpy.ops.facemime.puppet()
    assert LIVE_KEY not in head.data.shape_keys.key_blocks and running() is None
