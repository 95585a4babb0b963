"""Live puppetry: the modal operator moves the head until something stops it."""

import bpy
import numpy as np
import pytest

import facemime
from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.frames import to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_faces, read_selection
from facemime.blender.names import PART_PROPERTY, REGION_GROUPS
from facemime.blender.rigs import read_rig
from facemime.core.drive.driver import HeadDriver
from facemime.core.takes.neutral import calibrate
from facemime.core.tracking.identity import LEFTMOST
from facemime.operators.puppet import running
from facemime.sessions.live import LiveSession
from facemime.sessions.session import Session
from facemime.sessions.start import start_session
from facemime.settings.values import drive_settings
from tests.helpers.live_ticks import CLICK, attend, shown, start, tick, ticks_until

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def test_live_frames_equal_headless_ones_and_the_end_restores_the_head(take):
    head = add_head(bpy.context)
    before = shown(head)
    rig = read_rig(head)
    bpy.context.scene.facemime.source.speed = 1.0
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    ticks_until(lambda: np.abs(shown(head) - before).max() > 5e-3)
    running().worker.close()
    running().step()
    latest = running().shown
    wanted = HeadDriver(rig, calibrate(take), drive_settings(bpy.context.scene.facemime)).frame(latest.result)
    lashes = next(child for child in head.children if child[PART_PROPERTY] == "lashes")
    np.testing.assert_allclose(np.concatenate([shown(head), shown(lashes)]), to_blender(wanted.vertices), atol=1e-6)
    assert np.abs(shown(head) - before).max() > 1e-3
    assert bpy.ops.facemime.stop_puppet() == {"FINISHED"}
    assert head.data.shape_keys is None and running() is None
    np.testing.assert_array_equal(shown(head), before)
    assert tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)


def test_the_puppet_stops_at_the_end_of_the_source(take):
    add_head(bpy.context)
    bpy.ops.facemime.puppet()
    operator = running().operator
    ticks_until(lambda: running() is None)
    assert Session.current is None and operator._timer is None


def test_keep_pose_keeps_the_pose_without_changing_the_rest_shape(looping):
    head = add_head(bpy.context)
    rest = shown(head)
    bpy.context.scene.facemime.keep_pose = True
    bpy.ops.facemime.puppet()
    ticks_until(lambda: np.abs(shown(head) - rest).max() > 1e-3)
    bpy.ops.facemime.stop_puppet()
    assert np.abs(shown(head) - rest).max() > 1e-4
    np.testing.assert_array_equal(read_rig(head).vertices[:, 0], rest[:, 0])
    bpy.context.scene.facemime.keep_pose = False
    start()
    bpy.ops.facemime.stop_puppet()
    assert LIVE_KEY not in head.data.shape_keys.key_blocks
    np.testing.assert_allclose(shown(head), rest, atol=1e-7)


def test_existing_shape_keys_and_animation_are_kept(looping):
    head = add_head(bpy.context, units=True)
    head.data.shape_keys.key_blocks["jawOpen"].value = 0.4
    head.active_shape_key_index = 3
    bpy.ops.facemime.puppet_video(filepath=bpy.context.scene.facemime.source.take)
    names = [key.name for key in head.data.shape_keys.key_blocks]
    before, value = shown(head), head.data.shape_keys.key_blocks["jawOpen"].value
    start()
    bpy.ops.facemime.stop_puppet()
    assert [key.name for key in head.data.shape_keys.key_blocks] == names
    assert not any(key.mute for key in head.data.shape_keys.key_blocks)
    assert head.data.shape_keys.key_blocks["jawOpen"].value == pytest.approx(value)
    assert head.active_shape_key_index == 3
    bpy.context.scene.frame_set(bpy.context.scene.frame_current)
    np.testing.assert_allclose(shown(head), before, atol=1e-6)


@pytest.mark.parametrize(
    "end",
    [
        lambda: bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True),
        bpy.ops.facemime.stop_puppet,
        lambda: (facemime.unregister(), facemime.register()),
    ],
)
def test_every_way_to_stop_joins_the_thread_and_ends_the_operator(looping, end):
    add_head(bpy.context)
    start()
    session = running()
    end()
    assert not session.worker.running and session.operator is None and Session.current is None


def test_a_puppet_whose_window_is_closed_ends_at_the_next_opportunity(looping):
    head = add_head(bpy.context)
    start()
    session, operator = running(), running().operator
    for _ in range(2):
        operator.cancel(bpy.context)
    assert session.operator is None and head.data.shape_keys is not None
    attend()
    assert session.closed and Session.current is None and head.data.shape_keys is None
    assert bpy.ops.ed.undo() == {"FINISHED"}


def test_settings_take_effect_while_the_puppet_is_running(take):
    head = add_head(bpy.context)
    rest = shown(head)
    settings = bpy.context.scene.facemime
    settings.source.loop = True
    start()
    settings.strength_upper = settings.strength_middle = settings.strength_lower = 0.0
    settings.posing.rotation_strength = 0.0
    tick()
    ticks_until(lambda: np.abs(shown(head) - rest).max() < 1e-6)
    assert np.abs(np.array(head.delta_rotation_euler)).max() < 1e-6


def test_painted_regions_take_effect_after_the_next_click(looping):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    upper = head.vertex_groups[REGION_GROUPS[0]]
    untouched = [v.index for v in head.data.vertices if v.co.z < -0.08]
    for name in REGION_GROUPS[1:]:
        head.vertex_groups[name].remove(untouched)
    upper.remove(untouched)
    assert tick(CLICK) == {"PASS_THROUGH"}
    ticks_until(lambda: np.abs(shown(head) - rest)[untouched].max() < 1e-7)


def test_flipped_faces_take_effect_after_the_next_click_and_a_click_alone_does_nothing(looping):
    head = add_head(bpy.context)
    start()
    before = running().worker.heads
    tick(CLICK)
    for _ in range(5):
        tick()
    assert running().worker.heads is before
    head.data.flip_normals()
    tick(CLICK)
    ticks_until(lambda: running().worker.heads is not before)
    np.testing.assert_array_equal(running().worker.heads[0].rig.faces, read_faces(head.data))


def test_a_new_session_closes_the_previous_one(looping):
    head = add_head(bpy.context)
    first = start_session(bpy.context.scene, [head])
    second = start_session(bpy.context.scene, [head])
    assert not first.worker.running and Session.current is second
    assert isinstance(second, LiveSession)
    second.close()
    second.close()
    assert head.data.shape_keys is None


def test_control_points_selected_from_live_take_effect_at_once(looping):
    head = add_head(bpy.context)
    assert not bpy.ops.facemime.select_live_points.poll()
    start()
    assert bpy.ops.facemime.select_live_points(max_points=20) == {"FINISHED"}
    chosen = read_selection(head.data)
    assert len(chosen.landmarks) <= 20
    tick(CLICK)
    ticks_until(lambda: running().worker.heads[0].rig.control_points is not None)
    np.testing.assert_array_equal(running().worker.heads[0].rig.control_points, chosen.membership)


def test_the_session_tracks_the_face_chosen_in_the_settings(take):
    add_head(bpy.context)
    source = bpy.context.scene.facemime.source
    source.kind, source.loop = "SAMPLE", True
    bpy.ops.facemime.puppet()
    assert running().worker.options.face is None
    source.face = "LEFT"
    tick()
    assert running().worker.options.face == LEFTMOST
    bpy.ops.facemime.stop_puppet()


def test_next_face_requires_a_source_of_images(take):
    add_head(bpy.context)
    assert not bpy.ops.facemime.next_face.poll()
    source = bpy.context.scene.facemime.source
    source.loop = True
    start()
    assert not bpy.ops.facemime.next_face.poll()
    bpy.ops.facemime.stop_puppet()
    source.kind = "SAMPLE"
    bpy.ops.facemime.puppet()
    ticks_until(lambda: running().worker.latest is not None)
    assert bpy.ops.facemime.next_face() == {"FINISHED"}
    number = running().worker.latest.number
    ticks_until(lambda: running().worker.latest.number > number + 2)
    assert running().worker.latest.result.found
    bpy.ops.facemime.stop_puppet()
