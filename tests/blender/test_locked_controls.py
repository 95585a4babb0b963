"""Controls of a rig whose channels are locked or limited in part."""

import bpy
import numpy as np
import pytest

from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.setting import held
from facemime.blender.controls.stored import write_controls
from facemime.blender.fcurves import curves_in
from facemime.core.rigs.rig_map import ROTATION
from tests.helpers.face_rigs import bake, show, state
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")
OPENING, ALONG, SIDEWAYS = 0, 1, 2
"""Axes of the hinge, about which the jaw opens, rolls, and turns to a side."""


@pytest.fixture(params=["XYZ", "ZXY", "QUATERNION", "AXIS_ANGLE"])
def hinge(request, rigged):
    """The bone of the jaw in a rotation mode, whose first axis is across the face."""
    _, armature = rigged
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones["Hinge"].roll = 0.0
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.pose.bones["Hinge"].rotation_mode = request.param
    return armature.pose.bones["Hinge"]


def angles(bone):
    """The part of the rotation about each axis: Euler angles, or components of the quaternion."""
    if bone.rotation_mode == "AXIS_ANGLE":
        return np.sin(bone.rotation_axis_angle[0] / 2.0) * np.array(bone.rotation_axis_angle[1:])
    if bone.rotation_mode == "QUATERNION":
        return np.array(bone.rotation_quaternion[1:])
    return np.array(bone.rotation_euler)


@pytest.mark.parametrize("locked", first_of([(ALONG, SIDEWAYS), (ALONG,), (SIDEWAYS,)]))
def test_a_jaw_opens_about_the_axes_that_are_free(rigged, hinge, locked):
    head, _ = rigged
    for axis in locked:
        hinge.lock_rotation[axis] = True
    found = learn_controls(head)
    axes = {channel.index for channel in found.channels if channel.bone == "Hinge" and channel.kind == ROTATION}
    assert OPENING in axes and not axes.intersection(locked)
    write_controls(head, found)
    bake(head)
    most = np.zeros(3)
    for frame in range(1, 61, 2):
        bpy.context.scene.frame_set(frame)
        most = np.maximum(most, np.abs(angles(hinge)))
    assert most[OPENING] > 0.02
    np.testing.assert_allclose(most[list(locked)], 0.0, atol=1e-6)


def test_a_rotation_that_is_locked_altogether_is_left_alone(rigged, hinge):
    hinge.lock_rotation = (True, True, True)
    found = learn_controls(rigged[0])
    assert not any(channel.bone == "Hinge" and channel.kind == ROTATION for channel in found.channels)


def test_locked_angles_keep_the_value_that_the_user_gave_them(rigged):
    head, armature = rigged
    hinge = armature.pose.bones["Hinge"]
    hinge.rotation_mode = "XYZ"
    hinge.lock_rotation = (False, True, True)
    hinge.rotation_euler = (0.0, 0.03, -0.02)
    bpy.context.view_layer.update()
    before = state(armature)
    found = learn_controls(head)
    assert state(armature) == before
    write_controls(head, found)
    with held(found.channels) as controls:
        controls.write(np.full(len(found.channels), 0.1))
        np.testing.assert_allclose(hinge.rotation_euler, (0.1, 0.03, -0.02), atol=1e-6)
        np.testing.assert_allclose(controls.read()[[c.kind == ROTATION for c in found.channels]], 0.1, atol=1e-6)
    session = show(head)
    bpy.context.scene.frame_set(30)
    np.testing.assert_allclose(hinge.rotation_euler[1:], (0.03, -0.02), atol=1e-6)
    session.close()
    bake(head)
    path = hinge.path_from_id("rotation_euler")
    assert {curve.array_index for curve in curves_in(armature.animation_data) if curve.data_path == path} == {0}
    np.testing.assert_allclose(hinge.rotation_euler[1:], (0.03, -0.02), atol=1e-6)


@pytest.mark.parametrize("space", first_of(["WORLD", "LOCAL"]))
def test_limits_of_a_slider_without_a_parent_hold_in_the_world_as_in_its_own_space(rigged, space):
    slider = bpy.data.objects["Slider"]
    slider.constraints[0].owner_space = space
    (channel,) = (channel for channel in learn_controls(rigged[0]).channels if channel.owner == "Slider")
    assert (channel.low, channel.high) == pytest.approx((0.0, 0.2))


def test_world_limits_of_a_slider_with_a_parent_are_not_taken_for_its_own(rigged):
    parent = bpy.data.objects.new("Board", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.location = (3.0, 2.0, 1.0)
    slider = bpy.data.objects["Slider"]
    slider.constraints[0].owner_space = "WORLD"
    slider.parent = parent
    bpy.context.view_layer.update()
    channels = [channel for channel in learn_controls(rigged[0]).channels if channel.owner == "Slider"]
    assert not any(np.isfinite(channel.high) and channel.high < 0.1 for channel in channels)
