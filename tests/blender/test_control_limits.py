"""Controls are moved no farther than constraints let them, in whichever axes these limit them."""

import bpy
import numpy as np
import pytest

from facemime.blender.controls.probing import learn_controls
from facemime.core.rigs.rig_map import LOCATION
from tests.helpers.face_rigs import make_face_rig, state

NAME, REACH = "c6", 0.006


def limit_in(space):
    def limit(bone, armature):
        constraint = bone.constraints.new("LIMIT_LOCATION")
        constraint.owner_space = space
        rest = {"POSE": bone.matrix, "WORLD": armature.matrix_world @ bone.matrix}.get(space)
        for axis, middle in zip("xyz", (0.0, 0.0, 0.0) if rest is None else rest.translation, strict=True):
            setattr(constraint, f"use_min_{axis}", True)
            setattr(constraint, f"use_max_{axis}", True)
            setattr(constraint, f"min_{axis}", middle - REACH)
            setattr(constraint, f"max_{axis}", middle + REACH)
        return constraint

    return limit


def limit_distance(bone, armature):
    constraint = bone.constraints.new("LIMIT_DISTANCE")
    constraint.target = bpy.data.objects.new("Middle", None)
    bpy.context.scene.collection.objects.link(constraint.target)
    constraint.target.location = (armature.matrix_world @ bone.matrix).translation
    constraint.distance = REACH
    return constraint


def reaches(head):
    """Largest changes from rest of the location of the limited control."""
    found = [one for one in learn_controls(head).channels if one.bone == NAME and one.kind == LOCATION]
    return np.array([reach for one in found for reach in (one.high, -one.low)])


@pytest.mark.parametrize(
    "limit", [limit_in("WORLD"), limit_in("POSE"), limit_in("LOCAL_WITH_PARENT"), limit_in("LOCAL"), limit_distance]
)
def test_a_control_is_moved_as_far_as_its_limit_in_any_space(limit):
    head, armature = make_face_rig()
    bpy.context.view_layer.update()
    limit(armature.pose.bones[NAME], armature)
    before = state(armature)
    found = reaches(head)
    assert len(found) and found.max() < 1.8 * REACH and found.min() > 0.5 * REACH
    assert state(armature) == before


@pytest.mark.parametrize("change", ["mute", "wide"])
def test_a_limit_that_does_nothing_does_not_limit(change):
    head, armature = make_face_rig()
    bpy.context.view_layer.update()
    constraint = limit_distance(armature.pose.bones[NAME], armature)
    constraint.mute = change == "mute"
    constraint.distance = REACH if change == "mute" else 1.0
    assert len(found := reaches(head)) and np.isinf(found).all()
