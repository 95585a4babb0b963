"""Actions that no landmark shows, on heads in Blender: the tongue, live and baked."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live import LiveHeadObject
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import PoseTarget
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import PART_PROPERTY, TONGUE_KEY
from facemime.blender.rigs import read_rig
from facemime.blender.timeline import frames_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.face.names import ACTIONS, N_ACTIONS
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


def showing() -> Take:
    """A take that rests in its first half, then shows tongue and a puffed cheek."""
    take = performance()
    actions = np.full((len(take), N_ACTIONS), 0.1, np.float32)
    for name in ("tongueOut", "cheekPuffLeft"):
        actions[len(take) // 2 :, ACTIONS.index(name)] = 1.0
    actions[~take.found] = np.nan
    return replace(take, actions=actions)


def tongue_of(head: bpy.types.Object) -> bpy.types.ShapeKey:
    (tongue,) = (child for child in head.children if child[PART_PROPERTY] == "tongue")
    return tongue.data.shape_keys.key_blocks[TONGUE_KEY]


@pytest.mark.parametrize("units", first_of([False, True]))
def test_a_bake_puts_the_tongue_out_and_another_without_it_takes_it_back(units):
    head, scene = add_head(bpy.context, units=units), bpy.context.scene
    report = puppet_head(scene, head, showing())
    for frame, out in ((0, 0.0), (-1, 1.0)):
        scene.frame_set(round(float(frames_of(scene, report.motion.times[frame]))))
        assert tongue_of(head).value == pytest.approx(out, abs=0.1)
    puppet_head(scene, head, showing(), PuppetSettings(drive=DriveSettings(only_landmarks=True)))
    scene.frame_set(50)
    assert tongue_of(head).value == pytest.approx(0.0, abs=1e-6)


def test_the_tongue_follows_live_and_is_back_at_the_end():
    head, take = add_head(bpy.context), showing()
    frame = HeadDriver(read_rig(head), calibrate(take)).frame(take.result(len(take) - 1))
    shown = LiveHeadObject(head, {"head": PoseTarget.of(head)})
    shown.attach()
    shown.write(frame)
    assert tongue_of(head).value > 0.8
    shown.detach(keep=False)
    assert tongue_of(head).value == 0.0


def test_keys_with_arkits_names_get_the_measured_actions():
    head, scene = add_head(bpy.context, units=True), bpy.context.scene
    puppet_head(scene, head, showing(), PuppetSettings(bake=BakeSettings(keys="mapped")))
    scene.frame_set(55)
    keys = head.data.shape_keys.key_blocks
    assert 0.4 < keys["cheekPuff"].value < 0.65  # of one cheek, where ARKit has one key for both
    assert keys["mouthPressLeft"].value == pytest.approx(0.0, abs=0.05)


def test_a_head_of_an_earlier_version_without_the_key_is_driven_as_before():
    head = add_head(bpy.context)
    (tongue,) = (child for child in head.children if child[PART_PROPERTY] == "tongue")
    tongue.shape_key_clear()
    puppet_head(bpy.context.scene, head, showing())
    assert tongue.data.shape_keys is None


def test_live_the_tongues_baked_curve_is_muted_and_plays_again_at_the_end():
    head, take = add_head(bpy.context), showing()
    puppet_head(bpy.context.scene, head, take)
    shown = LiveHeadObject(head, {"head": PoseTarget.of(head)})
    shown.attach()
    bpy.context.scene.frame_set(55)
    assert tongue_of(head).value == 0.0
    shown.detach(keep=False)
    bpy.context.scene.frame_set(1)
    bpy.context.scene.frame_set(55)
    assert tongue_of(head).value > 0.9


def test_a_bake_mutes_the_users_animation_of_the_tongue_and_says_so():
    head = add_head(bpy.context)
    tongue_of(head).keyframe_insert("value", frame=1)
    report = puppet_head(bpy.context.scene, head, showing())
    assert any("(tongueOut)" in warning for warning in report.warnings)
    bpy.context.scene.frame_set(60)
    assert tongue_of(head).value == pytest.approx(1.0, abs=0.1)


def test_a_tongue_that_is_no_longer_a_mesh_is_left_alone():
    head = add_head(bpy.context)
    empty = bpy.data.objects.new("Tongue", None)
    bpy.context.collection.objects.link(empty)
    empty.parent, empty[PART_PROPERTY] = head, "tongue"
    assert puppet_head(bpy.context.scene, head, showing()).keys > 0
