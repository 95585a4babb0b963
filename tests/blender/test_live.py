"""Live puppeteering: ticks of the modal operator move the head, and everything that ends it leaves the scene right."""

import gc
import threading
import time
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

import facemime
from facemime.blender.frames import to_blender
from facemime.blender.head import add_head
from facemime.blender.live import LIVE_KEY, LiveHeadObject
from facemime.blender.meshes import read_rig, read_selection
from facemime.blender.names import REGION_GROUPS
from facemime.blender.targets import PoseTarget
from facemime.core.drive import HeadDriver
from facemime.core.errors import HeadError
from facemime.core.retarget import calibrate
from facemime.core.takes.file import save_take
from facemime.operators.puppet import FACEMIME_OT_puppet, running
from facemime.scene.preferences import preferences
from facemime.scene.settings import drive_options, read_calibration, write_calibration
from facemime.sessions.live import LiveSession
from facemime.sessions.session import Session
from facemime.sessions.start import start_session
from takes import performance

TIMER = SimpleNamespace(type="TIMER", value="NOTHING", ctrl=False, oskey=False)
CLICK = SimpleNamespace(type="LEFTMOUSE", value="PRESS", ctrl=False, oskey=False)


@pytest.fixture(autouse=True)
def _nothing_left_over():
    """Neither a session, nor its threads, nor the operator, of which Blender would complain at its end."""
    yield
    if Session.current is not None:
        Session.current.close()
    FACEMIME_OT_puppet.instance = None
    gc.collect()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("facemime")]


@pytest.fixture
def take(tmp_path):
    """The settings' source: a take, once, at once."""
    path = tmp_path / "take.facetake"
    save_take(performance(), path)
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.take = "TAKE", str(path)
    settings.source.loop, settings.source.speed, settings.smoothing = False, 20.0, 0.0
    write_calibration(settings, calibrate(performance()))
    return performance()


def tick(event=TIMER) -> set[str]:
    """One event for the operator that runs."""
    return FACEMIME_OT_puppet.instance.modal(bpy.context, event)


def ticks_until(condition, seconds: float = 30.0) -> None:
    """Ticks until `condition` holds or the operator has ended."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        if FACEMIME_OT_puppet.instance is None or tick() != {"PASS_THROUGH"}:
            assert condition()
            return
        time.sleep(0.002)


def outcome_of_ticks(seconds: float = 30.0) -> set[str]:
    """Ticks until the operator ends; how it ended."""
    end = time.monotonic() + seconds
    while (outcome := tick()) == {"PASS_THROUGH"}:
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.002)
    return outcome


def shown(obj: bpy.types.Object) -> np.ndarray:
    """(V, 3) what the viewport shows."""
    bpy.context.view_layer.update()
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def moving() -> bool:
    """Whether a frame with a face has been shown; the source must loop, as a busy machine drops frames."""
    session = running()
    return session is not None and session.shown is not None and session._number > 30 and bool(session.shown.heads)


def test_ticks_show_what_the_same_frame_gives_headless_and_the_end_puts_all_back(take):
    head = add_head(bpy.context)
    before = shown(head)
    rig = read_rig(head)
    bpy.context.scene.facemime.source.speed = 1.0
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    ticks_until(lambda: np.abs(shown(head) - before).max() > 5e-3)
    running().worker.close()
    running().step()
    latest = running().shown
    wanted = HeadDriver(rig, calibrate(take), drive_options(bpy.context.scene.facemime)).frame(latest.result)
    np.testing.assert_allclose(shown(head), to_blender(wanted.vertices), atol=1e-6)
    assert np.abs(shown(head) - before).max() > 1e-3
    assert bpy.ops.facemime.stop_puppet() == {"FINISHED"}
    assert head.data.shape_keys is None and running() is None
    np.testing.assert_array_equal(shown(head), before)
    assert tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)


def test_it_ends_with_the_source(take):
    add_head(bpy.context)
    bpy.ops.facemime.puppet()
    ticks_until(lambda: running() is None)
    assert FACEMIME_OT_puppet.instance is None


def test_keep_pose_leaves_the_head_and_the_rest_shape_apart(take):
    head = add_head(bpy.context)
    bpy.context.scene.facemime.source.loop = True
    rest = shown(head)
    bpy.context.scene.facemime.keep_pose = True
    bpy.ops.facemime.puppet()
    ticks_until(lambda: np.abs(shown(head) - rest).max() > 1e-3)
    bpy.ops.facemime.stop_puppet()
    assert np.abs(shown(head) - rest).max() > 1e-4
    np.testing.assert_array_equal(read_rig(head).vertices[:, 0], rest[:, 0])
    bpy.context.scene.facemime.keep_pose = False
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    bpy.ops.facemime.stop_puppet()
    assert LIVE_KEY not in head.data.shape_keys.key_blocks
    np.testing.assert_allclose(shown(head), rest, atol=1e-7)


def test_keys_and_animation_that_were_there_stay(take):
    head = add_head(bpy.context, units=True)
    bpy.context.scene.facemime.source.loop = True
    head.data.shape_keys.key_blocks["jawOpen"].value = 0.4
    head.active_shape_key_index = 3
    bpy.ops.facemime.puppet_video(filepath=bpy.context.scene.facemime.source.take)
    names = [key.name for key in head.data.shape_keys.key_blocks]
    before = shown(head)
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    bpy.ops.facemime.stop_puppet()
    assert [key.name for key in head.data.shape_keys.key_blocks] == names
    assert not any(key.mute for key in head.data.shape_keys.key_blocks)
    assert head.data.shape_keys.key_blocks["jawOpen"].value == pytest.approx(0.4)
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
def test_whatever_ends_it_joins_the_thread_and_the_operator_notices(take, end):
    add_head(bpy.context)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    worker = running().worker
    end()
    assert not worker.running and Session.current is None
    if FACEMIME_OT_puppet.instance is not None:
        assert tick() == {"FINISHED"}


def test_saving_in_the_middle_writes_the_head_at_rest(take, tmp_path):
    head = add_head(bpy.context)
    rest = shown(head)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "head.blend"))
    before = running()._number
    ticks_until(lambda: running()._number > before)
    assert LIVE_KEY in head.data.shape_keys.key_blocks
    bpy.ops.facemime.stop_puppet()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "head.blend"))
    again = bpy.data.objects["Facemime Head"]
    assert again.data.shape_keys is None
    np.testing.assert_array_equal(shown(again), rest)


def test_deleting_one_of_two_heads_goes_on_with_the_other_and_both_end_it(take):
    first, second = add_head(bpy.context), add_head(bpy.context)
    first.select_set(True)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    bpy.data.objects.remove(second)
    number = running()._number
    ticks_until(lambda: running()._number > number + 3)
    bpy.data.objects.remove(first)
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None


def test_renaming_the_head_and_other_active_objects_do_not_matter(take):
    head = add_head(bpy.context)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    head.name = "Somebody"
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.active_object
    number = running()._number
    ticks_until(lambda: running()._number > number + 3)
    assert cube.data.shape_keys is None and LIVE_KEY in head.data.shape_keys.key_blocks


def test_edit_mode_is_left_alone_and_a_mesh_that_was_changed_in_it_is_reported(take):
    head = add_head(bpy.context)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    bpy.ops.object.mode_set(mode="EDIT")
    number = running()._number
    ticks_until(lambda: running()._number > number + 3)
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    head.data.vertices[5].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="VERT")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None


def test_settings_act_while_it_runs(take):
    head = add_head(bpy.context)
    rest = shown(head)
    settings = bpy.context.scene.facemime
    settings.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    settings.strength_upper = settings.strength_middle = settings.strength_lower = 0.0
    settings.posing.rotation_strength = 0.0
    tick()
    ticks_until(lambda: np.abs(shown(head) - rest).max() < 1e-6)
    assert np.abs(np.array(head.delta_rotation_euler)).max() < 1e-6


def test_painted_regions_act_after_the_next_click(take):
    head = add_head(bpy.context)
    rest = shown(head)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    upper = head.vertex_groups[REGION_GROUPS[0]]
    untouched = [v.index for v in head.data.vertices if v.co.z < -0.08]
    for name in REGION_GROUPS[1:]:
        head.vertex_groups[name].remove(untouched)
    upper.remove(untouched)
    assert tick(CLICK) == {"PASS_THROUGH"}
    ticks_until(lambda: np.abs(shown(head) - rest)[untouched].max() < 1e-7)


def test_head_pose_goes_to_a_bone_and_the_eyes_to_objects(take):
    head = add_head(bpy.context)
    bpy.ops.object.armature_add()
    armature = bpy.context.active_object
    bpy.ops.object.empty_add()
    empty = bpy.context.active_object
    posing = bpy.context.scene.facemime.posing
    posing.object, posing.bone, posing.eye_left = armature, "Bone", empty
    bpy.context.view_layer.objects.active = head
    bpy.context.scene.facemime.source.loop = True
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    bone = armature.pose.bones["Bone"]
    ticks_until(lambda: bone.rotation_quaternion.angle > 0.05)
    frame = running().shown.heads
    assert frame and tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)
    bpy.ops.facemime.stop_puppet()
    assert bone.rotation_quaternion.angle < 1e-6
    posing.bone = "Nose"
    with pytest.raises(RuntimeError, match="no bone Nose"):
        bpy.ops.facemime.puppet()
    assert running() is None


@pytest.mark.parametrize("mode", ["XYZ", "QUATERNION", "AXIS_ANGLE"])
def test_a_pose_turns_the_head_about_its_own_axes_wherever_it_stands(mode):
    bpy.ops.object.empty_add(rotation=(0.3, 0.2, 1.1))
    parent = bpy.context.active_object
    head = add_head(bpy.context)
    head.parent, head.rotation_mode = parent, mode
    if mode == "QUATERNION":
        head.rotation_quaternion = (0.9, 0.1, -0.3, 0.2)
    else:
        head.rotation_euler = (0.4, -0.2, 0.7)
    bpy.context.view_layer.update()
    before = np.array(head.matrix_world.to_3x3().normalized())
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    target = PoseTarget(head)
    target.apply(turn, np.array([0.1, 0.2, 0.3]))
    bpy.context.view_layer.update()
    in_blender = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(np.array(head.matrix_world.to_3x3().normalized()), before @ in_blender, atol=1e-5)
    target.rest()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(head.matrix_world.to_3x3().normalized()), before, atol=1e-6)


def test_calibration_is_kept_with_the_scene_by_the_performers_name(take):
    add_head(bpy.context)
    settings = bpy.context.scene.facemime
    settings.source.loop = True
    assert [performer.name for performer in settings.performers] == ["Performer 1"]
    with pytest.raises(RuntimeError):
        bpy.ops.facemime.calibrate()
    bpy.ops.facemime.add_performer(name="Ada")
    assert read_calibration(settings) is None
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    assert bpy.ops.facemime.calibrate(countdown=0.05) == {"FINISHED"}
    assert running().countdown is not None
    ticks_until(lambda: settings.performers[1].calibration)
    assert settings.performer == 1 and running().worker.quality is not None
    np.testing.assert_array_equal(read_calibration(settings).shape, running().worker.neutral.shape)
    bpy.ops.facemime.stop_puppet()
    bpy.ops.facemime.remove_performer()
    assert [performer.name for performer in settings.performers] == ["Performer 1"]


@pytest.fixture
def preferred():
    """The user's settings, whose camera is put back."""
    yield preferences()
    preferences().property_unset("camera")


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("VIDEO", "", "No video is chosen"),
        ("VIDEO", "none.mp4", "There is no file"),
        ("PICTURES", "none", "There is no folder"),
        ("TAKE", "none.facetake", "There is no take"),
        ("CAMERA", "http://phone:8080/video", "Online Access"),
        ("CAMERA", "/dev/none", "cannot be opened"),
    ],
)
def test_a_source_that_is_not_there_is_reported_and_leaves_the_head_alone(tmp_path, preferred, kind, name, said):
    head = add_head(bpy.context)
    source = bpy.context.scene.facemime.source
    source.kind = kind
    path = name if "://" in name or not name else str(tmp_path / name)
    source.video = source.folder = source.take = path
    preferred.camera = path
    reports = []
    try:
        outcome = bpy.ops.facemime.puppet()
    except RuntimeError as error:
        reports, outcome = [str(error)], {"CANCELLED"}
    if outcome == {"RUNNING_MODAL"}:
        session = running()
        end = time.monotonic() + 30.0
        while session.worker.error is None and time.monotonic() < end:
            time.sleep(0.01)
        reports = [str(session.worker.error)]
        assert tick() == {"CANCELLED"}
    assert said in reports[0]
    assert running() is None and head.data.shape_keys is None


def test_the_buttons_say_why_they_are_grey(take):
    assert not FACEMIME_OT_puppet.poll(bpy.context)
    add_head(bpy.context)
    assert FACEMIME_OT_puppet.poll(bpy.context)
    assert not bpy.ops.facemime.stop_puppet.poll() and not bpy.ops.facemime.calibrate.poll()
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    assert not FACEMIME_OT_puppet.poll(bpy.context) and bpy.ops.facemime.stop_puppet.poll()


def test_a_damaged_calibration_is_reported(take):
    add_head(bpy.context)
    bpy.context.scene.facemime.performers[0].calibration = '{"shape": 3}'
    with pytest.raises(RuntimeError, match="Calibrate again"):
        bpy.ops.facemime.puppet()


def test_linked_heads_are_refused_with_what_to_do(take, tmp_path):
    add_head(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, loaded):
        loaded.objects = ["Facemime Head"]
    with pytest.raises(HeadError, match="Make Local"):
        LiveHeadObject(loaded.objects[0], {})


def test_a_new_session_ends_the_one_before(take):
    head = add_head(bpy.context)
    bpy.context.scene.facemime.source.loop = True
    first = start_session(bpy.context.scene, [head])
    second = start_session(bpy.context.scene, [head])
    assert not first.worker.running and Session.current is second
    assert isinstance(second, LiveSession)
    second.close()
    second.close()
    assert head.data.shape_keys is None


def test_control_points_are_chosen_from_what_the_puppet_showed_and_act_at_once(take):
    head = add_head(bpy.context)
    assert not bpy.ops.facemime.select_live_points.poll()
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    assert bpy.ops.facemime.select_live_points(max_points=20) == {"FINISHED"}
    chosen = read_selection(head.data)
    assert len(chosen.landmarks) <= 20
    tick(CLICK)
    ticks_until(lambda: running().worker.heads[0].rig.control_points is not None)
    np.testing.assert_array_equal(running().worker.heads[0].rig.control_points, chosen.membership)


def test_hiding_copying_and_another_scene_do_not_matter(take):
    head = add_head(bpy.context)
    bpy.context.scene.facemime.source.loop = True
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    snapshot = shown(copy)
    head.hide_set(True)
    first = bpy.context.scene
    bpy.context.window.scene = bpy.data.scenes.new("Other")
    number = running()._number
    ticks_until(lambda: running()._number > number + 3)
    bpy.context.window.scene = first
    head.hide_set(False)
    np.testing.assert_allclose(shown(copy), snapshot, atol=1e-6)
    bpy.ops.facemime.stop_puppet()
    assert head.data.shape_keys is None and copy.data.shape_keys is not None
