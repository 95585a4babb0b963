"""Sliders that have no limits, or one, and are as long as their makers like."""

import bpy
import numpy as np
import pytest

from facemime.blender.controls.finding import channels_of, driving_controls
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import write_controls
from facemime.blender.meshes import mesh_of
from tests.helpers.face_rigs import BLINK, bake, state
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def board(armature, name="board"):
    """Add a bone beside the face."""
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.data.edit_bones.new(name)
    bone.head, bone.tail = (0.5, 0.0, 0.0), (0.5, 0.0, 0.02)
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature.pose.bones[name]


def drive(head, target, length, **where):
    """Let a blink be driven by a coordinate that shuts the eye at `length`."""
    keys = mesh_of(head).shape_keys
    keys.driver_remove(f'key_blocks["{BLINK}"].value')
    driver = keys.key_blocks[BLINK].driver_add("value").driver
    driver.expression = f"var / {length}"
    variable = driver.variables.new()
    variable.type = "TRANSFORMS" if "transform_type" in where else "SINGLE_PROP"
    variable.targets[0].id = target
    for name, value in where.items():
        setattr(variable.targets[0], name, value)
    bpy.context.view_layer.update()


@pytest.mark.parametrize("length", first_of([0.01, 1.0, 30.0]))
@pytest.mark.parametrize("limit", first_of(["none", "upper", "world"]))
def test_a_bone_that_drives_a_key_is_learnt_however_long_its_way_is(rigged, length, limit):
    head, armature = rigged
    bone = board(armature)
    if limit != "none":
        constraint = bone.constraints.new("LIMIT_LOCATION")
        constraint.owner_space = "LOCAL" if limit == "upper" else "WORLD"
        constraint.use_max_y, constraint.max_y = True, length
    drive(head, armature, length, bone_target="board", transform_type="LOC_Y", transform_space="LOCAL_SPACE")
    before = state(armature)
    found = learn_controls(head)
    assert state(armature) == before
    chosen = [number for number, channel in enumerate(found.channels) if channel.bone == "board"]
    assert [found.channels[number].index for number in chosen] == [1]
    (variable,) = np.flatnonzero(found.channel == chosen[0])
    reach = found.scale[variable] * found.upper[variable]
    assert 0.2 * length < reach <= max(1.1 * length, 0.05)


@pytest.mark.parametrize("length", first_of([0.05, 2.0]))
def test_an_empty_without_limits_that_drives_a_key_is_learnt_and_baked(rigged, length):
    head, _ = rigged
    slider = bpy.data.objects["Slider"]
    slider.constraints.clear()
    drive(head, slider, length, data_path="location.z")
    write_controls(head, learn_controls(head))
    assert "Slider" in head.facemime_rig.controls
    bake(head)
    assert slider.animation_data.action is not None


def test_controls_that_drive_keys_are_known_by_property_bone_and_channel(rigged):
    head, armature = rigged
    bone = board(armature, 'a "b"')
    bone["x"] = 0.0
    drive(head, armature, 1.0, data_path='pose.bones["a \\"b\\""]["x"]')
    assert driving_controls(head) == {("Rig", 'a "b"'), ("Rig", "")}


def test_bones_beside_the_face_that_drive_nothing_are_not_moved_far(rigged):
    head, armature = rigged
    board(armature)
    bpy.context.view_layer.update()
    assert any(channel.bone == "board" for channel in channels_of(head))
    assert "board" not in learn_controls(head).controls
