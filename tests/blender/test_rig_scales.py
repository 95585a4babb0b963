"""Scales of bones that shape the lips: which are learnt, their limits, and the user's own."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live_controls import clear_controls
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import write_controls
from facemime.core.rigs.rig_map import SCALE
from tests.helpers.face_rigs import bake, show

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def test_of_scales_only_those_of_the_lips_are_used(rigged):
    head, armature = rigged
    scaled = {channel.bone for channel in learn_controls(head).channels if channel.kind == SCALE}
    assert scaled and scaled <= {f"c{number}" for number in range(9, 18)}
    locked = min(scaled)
    armature.pose.bones[locked].lock_scale = (True, True, True)
    assert {channel.bone for channel in learn_controls(head).channels if channel.kind == SCALE} == scaled - {locked}


def test_a_scale_keeps_to_its_limits(rigged):
    head, armature = rigged
    bone = next(channel.bone for channel in learn_controls(head).channels if channel.kind == SCALE)
    limit = armature.pose.bones[bone].constraints.new("LIMIT_SCALE")
    limit.owner_space = "LOCAL"
    for axis in "xyz":
        setattr(limit, f"use_min_{axis}", True)
        setattr(limit, f"min_{axis}", 0.9)
    found = learn_controls(head)
    scales = [channel for channel in found.channels if (channel.bone, channel.kind) == (bone, SCALE)]
    assert {(round(channel.low, 5), channel.high) for channel in scales} == {(-0.1, np.inf)}
    write_controls(head, found)
    bake(head)
    for frame in range(1, 61):
        bpy.context.scene.frame_set(frame)
        assert min(armature.pose.bones[bone].scale) >= 0.9 - 1e-5 and max(armature.pose.bones[bone].scale) <= 1.5 + 1e-5


def test_the_users_scale_of_a_lip_returns_after_a_preview(rigged):
    head, armature = rigged
    found = learn_controls(head)
    write_controls(head, found)
    bone = armature.pose.bones[next(channel.bone for channel in found.channels if channel.kind == SCALE)]
    bone.scale = before = (1.1, 0.95, 1.05)
    shown = show(head)
    bpy.context.scene.frame_set(40)
    assert bone.scale[:] != pytest.approx(before)
    clear_controls(armature)
    assert bone.scale[:] == pytest.approx(before)
    shown.close()
    assert bone.scale[:] == pytest.approx(before)
