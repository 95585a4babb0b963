"""Bones of a character: which one turns an eye, and the animation that a bone has of its own."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector

from facemime.blender.actions import baked_curves
from facemime.blender.animation.bake import remove_baked
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.characters import read_bones
from facemime.blender.frames import rotation_to_blender
from facemime.blender.heads.binding import bind_character
from facemime.blender.timeline import frames_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.characters import make_character, shown, turn_between
from tests.helpers.takes import coefficient_take, performance
from tests.helpers.thorough import first_of

AIMS = {"of its own": ("eye.L", "eye.R"), "shared": ("eyes", "eyes")}


@pytest.mark.parametrize("copies", first_of([False, True]))
@pytest.mark.parametrize("aims", AIMS)
@pytest.mark.parametrize("local", first_of([True, False]))
def test_an_eye_is_turned_by_the_control_that_it_looks_at(copies, aims, local):
    objects, armature = _looking_character("Head", copies=copies, aims=AIMS[aims])
    for name in AIMS[aims]:
        armature.data.bones[name].use_local_location = local
    head, _ = bind_character(objects["head"])
    armature.pose.bones[AIMS[aims][0]].location = (0.02, 0.0, -0.01)  # the user's own, to which the gaze is added
    bpy.context.view_layer.update()
    rest = shown(objects["eye_left"])
    report = puppet_head(bpy.context.scene, head, coefficient_take(), targets=own_targets(head))
    _assert_looks(report, rest, objects["eye_left"])
    paths = {curve.data_path for curve in baked_curves(armature)}
    assert {f'pose.bones["{name}"].location' for name in AIMS[aims]} <= paths
    assert not any("ORG-" in path or "rotation" in path for path in paths if "eye" in path)
    remove_baked(head, own_targets(head))
    np.testing.assert_allclose(armature.pose.bones[AIMS[aims][0]].location, (0.02, 0.0, -0.01), atol=1e-7)


@pytest.mark.parametrize("copies", first_of([False, True]))
def test_the_bone_of_an_eye_turns_it_if_it_looks_at_a_place_in_the_world(copies):
    objects, armature = _looking_character(None, copies=copies, aims=AIMS["of its own"])
    head, _ = bind_character(objects["head"])
    assert (read_bones(head)[1].eye_left, read_bones(head)[1].eye_right) == ("ORG-eye.L", "ORG-eye.R")
    assert own_targets(head)["eye_left"].bone == "ORG-eye.L"
    for side in "LR":
        armature.pose.bones[f"MCH-eye.{side}"].constraints[0].mute = True
    rest = shown(objects["eye_left"])
    report = puppet_head(bpy.context.scene, head, coefficient_take(), targets=own_targets(head))
    _assert_looks(report, rest, objects["eye_left"])


def test_a_bone_of_an_eye_that_itself_looks_at_a_control_is_found():
    objects, armature = _looking_character("Head", copies=False, aims=AIMS["of its own"])
    for side, name in (("L", "left"), ("R", "right")):
        objects[f"eye_{name}"].vertex_groups[0].name = f"MCH-eye.{side}"
        armature.data.bones[f"eye.{side}"].name = f"look.{side}"
        armature.data.bones[f"MCH-eye.{side}"].name = f"eye.{side}"
    head, _ = bind_character(objects["head"])
    assert read_bones(head)[1].eye_left == "eye.L"
    assert own_targets(head)["eye_left"].bone == "look.L"
    rest = shown(objects["eye_left"])
    report = puppet_head(bpy.context.scene, head, coefficient_take(), targets=own_targets(head))
    _assert_looks(report, rest, objects["eye_left"])


@pytest.mark.parametrize("shared", first_of([True, False]))
def test_an_eye_that_looks_at_an_object_on_the_head_is_turned_by_it(shared):
    objects, armature = _looking_character("Head", copies=False, aims=AIMS["of its own"])
    eyes = {"L": objects["eye_left"], "R": objects["eye_right"]}
    middles = {side: shown(eye).mean(axis=0) for side, eye in eyes.items()}
    empties = {}
    for side, middle in middles.items():
        empties[side] = empty = bpy.data.objects.new(f"Look {side}", None)
        bpy.context.scene.collection.objects.link(empty)
        empty.parent, empty.parent_type, empty.parent_bone = armature, "BONE", "Head"
        place = np.mean(list(middles.values()), axis=0) if shared else middle
        bpy.context.view_layer.update()
        empty.matrix_world = Matrix.Translation(Vector(place) - Vector((0.0, 0.3, 0.0)))
    for side in eyes:
        track = armature.pose.bones[f"MCH-eye.{side}"].constraints[0]
        track.target, track.subtarget = empties["L" if shared else side], ""
    bpy.context.view_layer.update()
    head, _ = bind_character(objects["head"])
    targets = own_targets(head)
    assert targets["eye_left"].obj == empties["L"] and ("eye_right" in targets) != shared
    rest = shown(objects["eye_left"])
    report = puppet_head(bpy.context.scene, head, coefficient_take(), targets=targets)
    _assert_looks(report, rest, objects["eye_left"])


def _looking_character(carrier, *, copies, aims):
    """A character with Rigify's bones of eyes, which look at controls that `carrier` carries; and its armature."""
    objects = make_character(rig=True)
    armature = objects["head"].parent
    eyes = {side: objects[f"eye_{name}"] for side, name in (("L", "left"), ("R", "right"))}
    middles = {side: shown(eye).mean(axis=0) for side, eye in eyes.items()}
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    places = {name: middles[side] for name, side in zip(aims, "LR", strict=True)}
    if len(places) == 1:
        places = {aims[0]: np.mean(list(middles.values()), axis=0)}
    made = [(name, middle, 0.3, carrier) for name, middle in places.items()]
    for side, middle in middles.items():
        made += [(f"MCH-eye.{side}", middle, 0.0, "Head"), (f"ORG-eye.{side}", middle, 0.0, f"MCH-eye.{side}")]
        made += [(f"DEF-eye.{side}", middle, 0.0, "Head")]
    for name, middle, away, parent in made:
        bone = bones.new(name)
        bone.head = middle - (0.0, away, 0.0)
        bone.tail = bone.head - Vector((0.0, 0.02, 0.0))
        bone.roll = 0.7 if away else 0.0
        bone.parent = bones[parent] if parent else None
    bpy.ops.object.mode_set(mode="OBJECT")
    for (side, eye), aim in zip(eyes.items(), aims, strict=True):
        track = armature.pose.bones[f"MCH-eye.{side}"].constraints.new("DAMPED_TRACK")
        track.target, track.subtarget = armature, aim
        eye.vertex_groups[0].name = f"DEF-eye.{side}" if copies else f"ORG-eye.{side}"
        copy = armature.pose.bones[f"DEF-eye.{side}"].constraints.new("COPY_TRANSFORMS")
        copy.target, copy.subtarget = armature, f"ORG-eye.{side}"
    return objects, armature


def _assert_looks(report, rest, eye):
    """Assert that an eye looks as the performer does, at the frame in which it is turned farthest."""
    row = int(np.argmin(report.motion.gaze[:, 1, 2, 2]))
    assert report.motion.gaze[row, 1, 2, 2] < np.cos(0.15)
    bpy.context.scene.frame_set(round(float(frames_of(bpy.context.scene, report.motion.times[row]))))
    expected = rotation_to_blender(report.motion.rotation[row] @ report.motion.gaze[row, 1])
    np.testing.assert_allclose(turn_between(rest, shown(eye)), expected, atol=0.06)


def _bound_with_own_animation(*, driven: bool) -> tuple[bpy.types.Object, bpy.types.Object]:
    """A character whose head bone turns by itself, by keyframes or a driver; the head and its armature."""
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    armature, _ = read_bones(head)
    bone = armature.pose.bones["Head"]
    if driven:
        bone.driver_add("rotation_quaternion", 1).driver.expression = "0.25"
    else:
        for frame, turn in ((1, 0.1), (40, 0.3)):
            bone.rotation_quaternion = (0.9, turn, 0.0, 0.0)
            bone.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.context.view_layer.objects.active = head
    return head, armature


def _turn_at(armature: bpy.types.Object, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    return np.array(armature.pose.bones["Head"].rotation_quaternion)


@pytest.mark.thorough
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("nla", [False, True])
def test_a_bone_with_animation_follows_the_performer_in_a_bake_which_says_what_was_muted(driven, nla):
    head, armature = _bound_with_own_animation(driven=driven)
    settings = PuppetSettings(bake=BakeSettings(nla=nla))
    report = puppet_head(bpy.context.scene, head, performance(), settings)
    assert any("(Head)" in warning for warning in report.warnings)
    frames = frames_of(bpy.context.scene, report.motion.times)
    for row in (0, 17, 29):
        turned = Matrix(own_targets(head)["head"].turned(report.motion.rotation[row]).tolist())
        found = _turn_at(armature, round(frames[row]))
        found /= np.linalg.norm(found)  # as curves need not meet between keyframes, and Blender does as well
        assert abs(found @ np.array(turned.to_quaternion())) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.thorough
def test_the_animation_of_a_bone_plays_again_when_a_bake_is_removed():
    head, armature = _bound_with_own_animation(driven=False)
    for _ in range(2):
        puppet_head(bpy.context.scene, head, performance())
    remove_baked(head, own_targets(head))
    assert not armature.animation_data.nla_tracks
    np.testing.assert_allclose(_turn_at(armature, 40)[:2], (0.9, 0.3), atol=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("strip", [False, True])
def test_a_take_is_added_to_the_animation_of_a_bone_on_request(strip):
    head, armature = _bound_with_own_animation(driven=False)
    if strip:
        data = armature.animation_data
        data.nla_tracks.new().strips.new("Walk", 1, data.action)
        data.action = None
    own = {frame: Quaternion(_turn_at(armature, frame)).normalized() for frame in (1, 20, 40)}
    settings = PuppetSettings(bake=BakeSettings(keep_animation=True))
    for _ in range(2):
        report = puppet_head(bpy.context.scene, head, performance(), settings)
    frames = frames_of(bpy.context.scene, report.motion.times)
    for frame, before in own.items():
        row = int(np.abs(frames - frame).argmin())
        turned = Matrix(own_targets(head)["head"].turned(report.motion.rotation[row]).tolist()).to_quaternion()
        assert abs(Quaternion(_turn_at(armature, frame)).normalized().dot(before @ turned)) > 1.0 - 2e-3
    remove_baked(head, own_targets(head))
    assert abs(Quaternion(_turn_at(armature, 20)).normalized().dot(own[20])) == pytest.approx(1.0, abs=1e-5)
