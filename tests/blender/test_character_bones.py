"""Bones of a character: which one turns an eye, and the animation that a bone has of its own."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector

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
from tests.helpers.takes import performance


@pytest.mark.parametrize("copies", [False, True])
def test_the_bone_of_an_eye_turns_it_and_is_not_the_control_that_it_looks_at(copies):
    objects = make_character(rig=True)
    armature = objects["head"].parent
    eyes = {side: objects[f"eye_{name}"] for side, name in (("L", "left"), ("R", "right"))}
    middles = {side: shown(eye).mean(axis=0) for side, eye in eyes.items()}
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    for side, middle in middles.items():
        for name, away, parent in (
            ("eye", 0.3, "Head"),
            ("MCH-eye", 0.0, "Head"),
            ("ORG-eye", 0.0, f"MCH-eye.{side}"),
            ("DEF-eye", 0.0, "Head"),
        ):
            bone = bones.new(f"{name}.{side}")
            bone.head = middle - (0.0, away, 0.0)
            bone.tail = bone.head - Vector((0.0, 0.02, 0.0))
            bone.parent = bones[parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    for side, eye in eyes.items():
        track = armature.pose.bones[f"MCH-eye.{side}"].constraints.new("DAMPED_TRACK")
        track.target, track.subtarget = armature, f"eye.{side}"
        eye.vertex_groups[0].name = f"DEF-eye.{side}" if copies else f"ORG-eye.{side}"
        copy = armature.pose.bones[f"DEF-eye.{side}"].constraints.new("COPY_TRANSFORMS")
        copy.target, copy.subtarget = armature, f"ORG-eye.{side}"
    head, _ = bind_character(objects["head"])
    assert (read_bones(head)[1].eye_left, read_bones(head)[1].eye_right) == ("ORG-eye.L", "ORG-eye.R")
    rest = shown(eyes["L"])
    report = puppet_head(bpy.context.scene, head, performance(), targets=own_targets(head))
    row = int(np.argmax(np.abs(report.motion.rotation[:, 0, 2])))
    bpy.context.scene.frame_set(round(float(frames_of(bpy.context.scene, report.motion.times[row]))))
    expected = report.motion.rotation[row] @ report.motion.gaze[row, 1]
    np.testing.assert_allclose(turn_between(rest, shown(eyes["L"])), rotation_to_blender(expected), atol=0.06)


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
