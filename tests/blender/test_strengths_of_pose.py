"""What a bake poses follows the strengths of a head and Detail; a bake on NLA tracks has one action."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.corrections import add_layer
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.refit import keyframe_count, refit
from facemime.blender.fcurves import curves_in
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import keys_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.sessions.show import TakeShow, follow_settings
from tests.helpers.takes import performance

FRAMES = (10, 25, 40, 50)


def part_of(head, kind):
    return next(child for child in head.children if child.get("facemime_part") == kind)


def bake(head, **settings):
    settings = PuppetSettings(bake=BakeSettings(**settings), neutral=0.0)
    return puppet_head(bpy.context.scene, head, performance(), settings)


def turns(obj):
    """Angles of the delta rotation of an object in some frames, radians."""
    found = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        found.append(obj.delta_rotation_euler.to_quaternion().angle)
    return np.array(found)


def values(head, key):
    """Values of a shape key in some frames."""
    found = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        found.append(keys_of(head).key_blocks[key].value)
    return np.array(found)


@pytest.mark.parametrize("again", [False, True], ids=["at once", "in another bake"])
def test_strengths_scale_the_eyes_and_the_lower_teeth(again):
    head = add_head(bpy.context, units=True)
    eye, teeth = part_of(head, "eye_left"), part_of(head, "teeth_lower")
    bake(head)
    looks, opens = turns(eye), turns(teeth)
    assert looks.max() > 0.02 and opens.max() > 0.02
    head.facemime.strength_gaze, head.facemime.strength_jaw = 0.5, 0.0
    if again:
        bake(head)
    np.testing.assert_allclose(turns(eye), 0.5 * looks, atol=0.01)
    np.testing.assert_allclose(turns(teeth), 0.0, atol=0.01)
    head.facemime.strength_gaze = head.facemime.strength_jaw = 1.0
    if again:
        bake(head)
    np.testing.assert_allclose(turns(eye), looks, atol=0.01)


@pytest.mark.parametrize("where", ["below corrections", "on NLA tracks"])
def test_strengths_and_detail_act_at_once_where_the_bake_is_on_tracks(where):
    head = add_head(bpy.context, units=True)
    eye = part_of(head, "eye_left")
    bake(head, nla=where == "on NLA tracks")
    if where == "below corrections":
        add_layer(head)
        jaw = keys_of(head).key_blocks["jawOpen"]
        jaw.value = 0.0
        jaw.keyframe_insert("value", frame=10)
        added = curves_in(keys_of(head).animation_data)[0]
        added.keyframe_points[0].co.y = added.keyframe_points[0].handle_left.y = 0.1
        added.keyframe_points[0].handle_right.y = 0.1
        added.update()
    looks, opens = turns(eye), values(head, "jawOpen")
    assert opens.max() > 0.2
    head.facemime.strength_gaze, head.facemime.strength_jaw = 0.5, 0.0
    np.testing.assert_allclose(turns(eye), 0.5 * looks, atol=0.01)
    corrected = 0.1 if where == "below corrections" else 0.0
    np.testing.assert_allclose(values(head, "jawOpen"), corrected, atol=0.02)
    head.facemime.strength_gaze = head.facemime.strength_jaw = 1.0
    np.testing.assert_allclose(values(head, "jawOpen"), opens, atol=0.01)
    fewest = keyframe_count(head)
    assert refit(0.0) and keyframe_count(head) > 2 * fewest


def test_keyframes_of_the_strength_of_the_gaze_count():
    head = add_head(bpy.context, units=True)
    eye = part_of(head, "eye_left")
    bake(head)
    looks = turns(eye)
    for frame, value in ((30, 1.0), (31, 0.0)):
        head.facemime.strength_gaze = value
        head.keyframe_insert("facemime.strength_gaze", frame=frame)
    bake(head)
    np.testing.assert_allclose(turns(eye), looks * (1.0, 1.0, 0.0, 0.0), atol=0.01)


def test_an_eye_that_was_keyed_by_hand_is_not_scaled_any_more():
    head = add_head(bpy.context, units=True)
    eye = part_of(head, "eye_left")
    bake(head)
    bpy.context.scene.frame_set(25)
    eye.delta_rotation_euler.x = 0.3
    eye.keyframe_insert("delta_rotation_euler", frame=25)
    before = turns(eye)
    head.facemime.strength_gaze = 0.5
    np.testing.assert_allclose(turns(eye), before, atol=1e-6)


def test_keys_that_show_the_gaze_follow_its_strength_and_not_that_of_the_eyes():
    head = add_head(bpy.context, units=True)
    bake(head, keys="mapped")
    keys = keys_of(head)

    def largest(name):
        (curve,) = [curve for curve in curves_in(keys.animation_data) if f'"{name}"' in curve.data_path]
        return max(abs(curve.evaluate(frame)) for frame in range(1, 61))

    names = [f"eyeLook{way}Left" for way in ("In", "Out", "Up", "Down")]
    looks = max(largest(name) for name in names)
    assert looks > 0.05
    head.facemime.strength_gaze = 0.0
    assert max(largest(name) for name in names) < 1e-6
    head.facemime.strength_gaze, head.facemime.strength_eyes = 1.0, 0.0
    assert max(largest(name) for name in names) == pytest.approx(looks, abs=0.01)


def test_the_strength_of_the_eyes_acts_at_once_while_a_take_is_shown():
    head = add_head(bpy.context, units=True)
    settings = bpy.context.scene.facemime
    settings.find_neutral, settings.neutral = False, 0.0
    session = TakeShow(bpy.context.scene, [head], performance())
    bpy.context.scene.frame_set(50)
    eye = part_of(head, "eye_left")
    full = eye.delta_rotation_euler.to_quaternion().angle
    settings.posing.eyes_strength = 0.5
    follow_settings()
    assert full > 0.02 and eye.delta_rotation_euler.to_quaternion().angle == pytest.approx(0.5 * full, abs=1e-3)
    session.close()


@pytest.mark.parametrize("mode", ["XYZ", "QUATERNION"])
def test_detail_fits_the_pose_again_within_its_error(mode):
    head = add_head(bpy.context, units=True)
    head.rotation_mode = mode
    report = bake(head, clean=0.02)
    path = "delta_rotation_euler" if mode == "XYZ" else "delta_rotation_quaternion"

    def curves():
        return [curve for curve in curves_in(head.animation_data) if curve.data_path == path]

    def angles():
        found = []
        for frame in range(1, 61):
            bpy.context.scene.frame_set(frame)
            own = head.delta_rotation_euler.to_quaternion() if mode == "XYZ" else head.delta_rotation_quaternion
            found.append(np.array(own.normalized().to_matrix()))
        return np.array(found)

    few = sum(len(curve.keyframe_points) for curve in curves())
    coarse = angles()
    assert refit(0.0)
    assert all(len(curve.keyframe_points) > 50 for curve in curves())
    exact = angles()
    assert refit(0.002)
    many, fine = sum(len(curve.keyframe_points) for curve in curves()), angles()
    assert few < many < 50 * len(curves())

    def off(found):
        return np.linalg.norm(found - exact, axis=(1, 2)).max() / np.sqrt(2.0)

    assert off(coarse) < 0.02 and off(fine) < 0.002
    steps = np.diff(np.array([[curve.evaluate(frame) for curve in curves()] for frame in range(1, 61)]), axis=0)
    assert np.abs(steps).max() < 0.3, "no jump between equivalent rotations"
    assert report.keyframes


def test_a_bake_on_nla_tracks_is_one_action_and_another_replaces_it():
    head = add_head(bpy.context, units=True)
    bake(head)
    looks = turns(part_of(head, "eye_left"))
    for _ in range(2):
        bake(head, nla=True)
        owners = [head, keys_of(head), *head.children]
        strips = [
            strip
            for owner in owners
            if owner.animation_data
            for track in owner.animation_data.nla_tracks
            for strip in track.strips
        ]
        assert len(strips) > 3
        if hasattr(bpy.types.Action, "slots"):
            assert len({strip.action.name for strip in strips}) == 1
            assert len({strip.action_slot.handle for strip in strips}) == len(strips)
        np.testing.assert_allclose(turns(part_of(head, "eye_left")), looks, atol=1e-3)
