"""Where the user put a head, and how the user animated it, stays: a performance is added to it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Quaternion

from facemime.blender.animation.bake import remove_baked
from facemime.blender.animation.live import Follow, LiveHeadObject
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.frames import rotation_to_blender
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rigs import read_rig
from facemime.blender.timeline import frames_of
from facemime.core.drive.driver import HeadDriver
from facemime.core.puppet.puppet_settings import BakeSettings, PuppetSettings
from facemime.core.takes.neutral import calibrate
from facemime.sessions.show import TakeShow
from tests.helpers.characters import make_character
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")

MODES = ["XYZ", "ZYX", "QUATERNION", "AXIS_ANGLE"]
OF_BONES = ["QUATERNION", *(pytest.param(mode, marks=pytest.mark.thorough) for mode in MODES if mode != "QUATERNION")]
CHANNELS = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale", "rotation_mode")
DELTAS = ("delta_location", "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale")


def values_of(owner, channels=(*CHANNELS, *DELTAS)):
    """All transform channels of an object."""
    values = [getattr(owner, name) for name in channels]
    return [value if isinstance(value, str) else tuple(value) for value in values]


def placed_head(mode="XYZ", **deltas):
    """A head with a location, a rotation and delta transforms of its user's."""
    head = add_head(bpy.context)
    head.rotation_mode, head.location = mode, (0.5, -1.0, 0.25)
    turn = Euler((0.2, -0.3, 1.2)).to_quaternion()
    if mode == "QUATERNION":
        head.rotation_quaternion = turn
    elif mode == "AXIS_ANGLE":
        head.rotation_axis_angle = (turn.angle + 2.0 * np.pi, *turn.axis)
    else:
        head.rotation_euler = turn.to_euler(mode)
    head.delta_location, head.delta_scale = (0.0, 0.0, 1.5), (1.0, 1.0, 1.2)
    if mode != "AXIS_ANGLE":  # these have no delta rotation
        head.delta_rotation_euler, head.delta_rotation_quaternion = (0.1, 0.0, 0.5), Quaternion((0.9, 0.0, 0.3, 0.3))
    bpy.context.view_layer.update()
    return head


def world(obj):
    """(4, 4) transform in the scene, after an update."""
    bpy.context.view_layer.update()
    return np.array(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world)


def turn_of(before, after):
    """Rotation between two transforms, about the axes of the first."""
    rotations = [np.array(Matrix(one.tolist()).to_quaternion().to_matrix()) for one in (before, after)]
    return rotations[0].T @ rotations[1]


@pytest.mark.parametrize("mode", first_of(MODES, 2))
def test_a_bake_adds_the_pose_to_the_users_delta_transform_and_its_removal_gives_that_back(mode):
    head = placed_head(mode)
    before, channels = world(head), values_of(head)
    for _ in range(2):  # another bake starts from the same placement
        report = puppet_head(bpy.context.scene, head, performance(), PuppetSettings(translation=True))
        row = int(np.argmax(np.linalg.norm(report.motion.translation, axis=1)))
        frame = float(frames_of(bpy.context.scene, report.motion.times[row]))
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1.0)
        after = world(head)
        np.testing.assert_allclose(turn_of(before, after), rotation_to_blender(report.motion.rotation[row]), atol=2e-3)
        moved = np.linalg.norm(after[:3, 3] - before[:3, 3])
        assert moved < 1.3 * np.linalg.norm(report.motion.translation[row]) + 1e-6
    remove_baked(head, own_targets(head))
    np.testing.assert_allclose(world(head), before, atol=1e-6)
    assert values_of(head) == channels


@pytest.mark.parametrize("mode", MODES)
def test_a_preview_adds_the_pose_and_gives_every_channel_back(mode):
    head, scene = placed_head(mode), bpy.context.scene
    scene.facemime.translation = True
    before, channels = world(head), values_of(head)
    show = TakeShow(scene, [head], performance())
    scene.frame_set(1)
    assert np.abs(world(head) - before).max() < 0.1
    scene.frame_set(60)
    assert 0.01 < np.abs(world(head) - before).max() < 0.3
    show.close()
    np.testing.assert_allclose(world(head), before, atol=1e-6)
    assert values_of(head) == channels


def test_a_live_pose_that_is_kept_is_replaced_by_the_next_and_not_added_to_it():
    head, take = placed_head(), performance()
    frame = HeadDriver(read_rig(head), calibrate(take)).frame(take.result(55))
    poses = []
    for _ in range(2):
        shown = LiveHeadObject(head, own_targets(head), Follow(translation=True))
        shown.attach()
        shown.write(frame)
        poses.append(world(head))
        shown.detach(keep=True)
    np.testing.assert_allclose(*poses, atol=1e-6)


def test_a_placement_after_a_kept_pose_counts():
    head, take = placed_head(), performance()
    frame = HeadDriver(read_rig(head), calibrate(take)).frame(take.result(55))
    shown = LiveHeadObject(head, own_targets(head))
    shown.attach()
    shown.write(frame)
    shown.detach(keep=True)
    head.delta_location = (3.0, 0.0, 0.0)
    again = LiveHeadObject(head, own_targets(head))
    again.attach()
    again.write(frame)
    again.detach(keep=False)
    assert tuple(head.delta_location) == (3.0, 0.0, 0.0)


@pytest.mark.parametrize("mode", ["XYZ", "AXIS_ANGLE"])
def test_a_head_that_its_user_turns_keeps_turning_and_nods_about_its_own_axes(mode):
    head, scene = add_head(bpy.context), bpy.context.scene
    head.rotation_mode = mode
    channel = "rotation_axis_angle" if mode == "AXIS_ANGLE" else "rotation_euler"
    for frame, angle in ((1, 0.0), (90, 2.4)):
        setattr(head, channel, (angle, 0.0, 0.0, 1.0) if mode == "AXIS_ANGLE" else (0.0, 0.0, angle))
        head.keyframe_insert(channel, frame=frame)

    def places(frames):
        found = []
        for frame in frames:
            scene.frame_set(int(frame))
            found.append(world(head))
        return found

    frames = (20, 50, 80)
    before = places(frames)
    report = puppet_head(scene, head, performance())
    times = frames_of(scene, report.motion.times)
    for frame, own, posed in zip(frames, before, places(frames), strict=True):
        wanted = rotation_to_blender(report.motion.rotation[int(np.abs(times - frame).argmin())])
        np.testing.assert_allclose(turn_of(own, posed), wanted, atol=0.02)
    remove_baked(head, own_targets(head))
    assert head.rotation_mode == mode
    for own, rest in zip(before, places(frames), strict=True):
        np.testing.assert_allclose(rest, own, atol=1e-5)


@pytest.mark.parametrize("mode", OF_BONES)
def test_the_pose_of_a_bone_is_added_to_the_users(mode):
    head, _ = bind_character(make_character(rig=True)["head"])
    target = own_targets(head)["head"]
    bone = target.owner
    bone.rotation_mode = mode
    bone.matrix_basis = Matrix.LocRotScale((0.0, 0.02, 0.0), Euler((0.3, 0.2, -0.4)), None)
    channels = values_of(bone, CHANNELS)
    own = np.array(bone.matrix_basis)
    report = puppet_head(bpy.context.scene, head, performance(), targets=own_targets(head))
    row = int(np.argmax([abs(np.arccos((np.trace(turn) - 1.0) / 2.0)) for turn in report.motion.rotation]))
    frame = float(frames_of(bpy.context.scene, report.motion.times[row]))
    bpy.context.scene.frame_set(int(frame), subframe=frame % 1.0)
    assert bone.rotation_mode == mode
    np.testing.assert_allclose(
        turn_of(own, np.array(bone.matrix_basis)), target.turned(report.motion.rotation[row]), atol=2e-3
    )
    np.testing.assert_allclose(np.array(bone.matrix_basis)[:3, 3], own[:3, 3], atol=1e-6)
    remove_baked(head, own_targets(head))
    np.testing.assert_allclose(np.array(bone.matrix_basis), own, atol=1e-6)
    assert values_of(bone, CHANNELS) == channels


@pytest.mark.parametrize("mode", OF_BONES[:3])
def test_a_pose_that_is_added_to_an_animated_bone_turns_it_about_its_own_axes(mode):
    head, _ = bind_character(make_character(rig=True)["head"])
    target, scene = own_targets(head)["head"], bpy.context.scene
    bone = target.owner
    bone.rotation_mode = mode
    channel = "rotation_quaternion" if mode == "QUATERNION" else "rotation_euler"
    for frame, angle in ((1, 0.0), (90, 1.1)):
        turn = Euler((0.5, angle, -0.4))
        setattr(bone, channel, turn.to_quaternion() if mode == "QUATERNION" else turn.to_quaternion().to_euler(mode))
        bone.keyframe_insert(channel, frame=frame)

    def poses():
        found = []
        for frame in (5, 40, 55):
            scene.frame_set(frame)
            found.append(np.array(bone.matrix_basis))
        return found

    before = poses()
    report = puppet_head(scene, head, performance(), PuppetSettings(bake=BakeSettings(keep_animation=True)))
    times = frames_of(scene, report.motion.times)
    for frame, own, posed in zip((5, 40, 55), before, poses(), strict=True):
        wanted = target.turned(report.motion.rotation[int(np.abs(times - frame).argmin())])
        np.testing.assert_allclose(turn_of(own, posed), wanted, atol=0.02)


def test_a_head_on_a_moving_bone_stays_on_it():
    armature = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.data.edit_bones.new("neck")
    bone.head, bone.tail = (0.0, 0.0, 0.0), (0.0, 0.3, 1.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    head = placed_head()
    head.parent, head.parent_type, head.parent_bone = armature, "BONE", "neck"
    posed = armature.pose.bones["neck"]
    posed.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (90, 1.0)):
        posed.rotation_euler = (0.0, 0.0, angle)
        posed.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_set(50)
    before = world(head)
    report = puppet_head(bpy.context.scene, head, performance(), PuppetSettings(translation=True))
    row = int(np.abs(frames_of(bpy.context.scene, report.motion.times) - 50).argmin())
    bpy.context.scene.frame_set(50)
    np.testing.assert_allclose(
        turn_of(before, world(head)), rotation_to_blender(report.motion.rotation[row]), atol=0.02
    )


@pytest.mark.parametrize("shared", ["keys", "pose"])
def test_a_bake_leaves_an_action_that_another_character_plays_to_it(shared):
    first, second = (add_head(bpy.context, name=name) for name in "AB")
    puppet_head(bpy.context.scene, first, performance())
    owners = [head.data.shape_keys if shared == "keys" else head for head in (first, second)]
    if shared == "keys":
        second.shape_key_add(name="Basis")
        owners[1] = second.data.shape_keys
    action = owners[0].animation_data.action
    data = owners[1].animation_data_create()
    data.action = action
    if hasattr(action, "slots"):
        data.action_slot = owners[0].animation_data.action_slot

    def state():
        bpy.context.scene.frame_set(60)
        values = [key.value for key in first.data.shape_keys.key_blocks]
        return [*values, *world(first).reshape(-1)]

    before = state()
    show = TakeShow(bpy.context.scene, [second], performance())
    bpy.context.scene.frame_set(60)
    assert state() == before
    show.close()
    puppet_head(bpy.context.scene, second, performance(50))
    np.testing.assert_allclose(state(), before, atol=1e-6)
    assert owners[0].animation_data.action == action and data.action != action


@pytest.mark.parametrize("moved_by", first_of(["a driver", "a muted curve", "a strip of a muted track"], 2))
def test_a_placement_by_a_driver_or_beside_muted_animation_stays(moved_by):
    head, scene = add_head(bpy.context), bpy.context.scene
    if moved_by == "a driver":
        head.driver_add("delta_location", 2).driver.expression = "1.5"
    else:
        head.keyframe_insert("delta_location", frame=1)
        head.delta_location = (0.0, 0.0, 1.5)
        for curve in curves_of(head):
            curve.mute = moved_by == "a muted curve"
        if moved_by == "a strip of a muted track":
            track = head.animation_data.nla_tracks.new()
            track.strips.new("Strip", 1, head.animation_data.action)
            track.mute, head.animation_data.action = True, None
    scene.frame_set(1)
    before = world(head)
    for _ in range(2):
        puppet_head(scene, head, performance(), PuppetSettings())
        np.testing.assert_allclose(world(head)[:3, 3], before[:3, 3], atol=1e-6)
    remove_baked(head, own_targets(head))
    np.testing.assert_allclose(world(head), before, atol=1e-6)


@pytest.mark.parametrize("mode", first_of(["XYZ", "QUATERNION"]))
@pytest.mark.parametrize("kept_in", ["the action", "an NLA track"])
def test_a_preview_follows_an_animated_delta_transform_and_leaves_it(mode, kept_in):
    head, scene = placed_head(mode), bpy.context.scene
    channel = "delta_rotation_quaternion" if mode == "QUATERNION" else "delta_rotation_euler"
    for frame, angle in ((1, 0.0), (90, 1.4)):
        turn = Euler((0.1, 0.0, angle))
        setattr(head, channel, turn.to_quaternion() if mode == "QUATERNION" else turn)
        head.delta_location = (0.0, angle, 1.5)
        for path in (channel, "delta_location"):
            head.keyframe_insert(path, frame=frame)
    if kept_in == "an NLA track":
        data = head.animation_data
        action, slot = data.action, getattr(data, "action_slot", None)
        strip = data.nla_tracks.new().strips.new("Strip", 1, action)
        if slot is not None:
            strip.action_slot = slot
        data.action = None

    def places():
        found = []
        for frame in (5, 40, 55):
            scene.frame_set(frame)
            found.append(world(head))
        return found

    before = places()
    show, take = TakeShow(scene, [head], performance()), performance()
    shown = places()
    show.close()
    for place, again in zip(before, places(), strict=True):
        np.testing.assert_allclose(again, place, atol=1e-5)
    report = puppet_head(scene, head, take)
    baked = places()
    times = frames_of(scene, report.motion.times)
    for frame, own, posed, by_bake in zip((5, 40, 55), before, shown, baked, strict=True):
        wanted = rotation_to_blender(report.motion.rotation[int(np.abs(times - frame).argmin())])
        np.testing.assert_allclose(turn_of(own, posed), wanted, atol=0.02)
        np.testing.assert_allclose(posed[:3, 3], own[:3, 3], atol=1e-5)
        np.testing.assert_allclose(turn_of(own, by_bake), wanted, atol=0.02)
    again = TakeShow(scene, [head], performance())
    for place, posed in zip(shown, places(), strict=True):
        np.testing.assert_allclose(posed, place, atol=1e-5)
    again.close()


def test_a_delta_location_stays_beside_an_animated_delta_rotation():
    head, scene = placed_head(), bpy.context.scene
    for frame, angle in ((1, 0.0), (90, 1.4)):
        head.delta_rotation_euler = (0.1, 0.0, angle)
        head.keyframe_insert("delta_rotation_euler", frame=frame)
    scene.frame_set(40)
    before = world(head)
    for settings in (PuppetSettings(), PuppetSettings(translation=True)):
        puppet_head(scene, head, performance(), settings)
        scene.frame_set(40)
        assert np.linalg.norm(world(head)[:3, 3] - before[:3, 3]) < (0.1 if settings.translation else 1e-5)
    remove_baked(head, own_targets(head))
    scene.frame_set(40)
    np.testing.assert_allclose(world(head), before, atol=1e-5)


@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize(
    "modes", first_of([("XYZ", "QUATERNION"), ("QUATERNION", "XYZ"), ("XYZ", "QUATERNION", "XYZ")])
)
def test_a_rotation_mode_that_was_changed_during_a_session_leaves_no_pose_in_the_hidden_channels(modes, keep):
    head = placed_head(modes[0])
    before = values_of(head, DELTAS[1:3])
    shown = LiveHeadObject(head, own_targets(head))
    take = performance()
    driver = HeadDriver(read_rig(head), calibrate(take))
    shown.attach()
    for mode in modes:
        head.rotation_mode = mode
        shown.write(driver.frame(take.result(42)))
    shown.detach(keep=keep)
    hidden = DELTAS[2] if modes[-1] == "XYZ" else DELTAS[1]
    np.testing.assert_allclose(getattr(head, hidden), before[DELTAS.index(hidden) - 1], atol=1e-6)
    if not keep:
        turn = Quaternion(before[1]).normalized() if modes[0] == "QUATERNION" else Euler(before[0]).to_quaternion()
        now = head.delta_rotation_quaternion if modes[-1] == "QUATERNION" else head.delta_rotation_euler.to_quaternion()
        assert now.normalized().rotation_difference(turn).angle < 1e-3
