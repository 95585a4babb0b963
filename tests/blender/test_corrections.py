"""Corrections of a bake: added to it, left by another bake, and followed by the other meshes of the head."""

import bpy
import numpy as np
import pytest

from facemime.blender.actions import Curve, write_curves
from facemime.blender.animation.corrections import add_layer, has_layer, remove_layer
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.refit import keyframe_count, refit
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.characters import make_character
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance

FRAMES = (5, 20, 30, 40, 55)


def bake(head, count=60, **settings):
    settings = PuppetSettings(bake=BakeSettings(**settings))
    return puppet_head(bpy.context.scene, head, performance(count), settings)


def values(obj, name="jawOpen", after=0):
    found = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame + after)
        found.append(obj.data.shape_keys.key_blocks[name].value)
    return np.array(found)


def correct(head, name="jawOpen", value=0.6):
    """Key a shape key as an animator does: unchanged around frame 30, and at a value there."""
    block = head.data.shape_keys.key_blocks[name]
    for frame in (20, 40):
        bpy.context.scene.frame_set(frame)
        assert block.keyframe_insert("value", frame=frame)
    bpy.context.scene.frame_set(30)
    block.value = value
    assert block.keyframe_insert("value", frame=30)


def test_corrections_are_added_to_the_bake_and_another_bake_leaves_them():
    head = add_head(bpy.context)
    bake(head)
    before = values(head)
    add_layer(head)
    np.testing.assert_allclose(values(head), before, atol=1e-5)
    baked = keyframe_count(head)
    correct(head)
    assert keyframe_count(head) == baked, "the user's keyframes do not belong to the bake"
    after = values(head)
    assert refit(BakeSettings().clean)
    np.testing.assert_allclose(values(head), after, atol=1e-4)
    assert after[2] == pytest.approx(0.6, abs=1e-4)
    np.testing.assert_allclose(np.delete(after, 2), np.delete(before, 2), atol=1e-4)
    for count in (50, 60):
        report = bake(head, count)
        assert not any("Muted" in warning or "Other animation" in warning for warning in report.warnings)
        assert head.data.shape_keys.animation_data.action.name.endswith("Corrections") and has_layer(head)
        assert len(head.data.shape_keys.animation_data.nla_tracks) == 1
    np.testing.assert_allclose(values(head), after, atol=1e-4)
    bake(head, keys="new")
    assert values(head)[2] == pytest.approx(0.6 - before[2], abs=1e-4)
    bake(head)
    remove_layer(head)
    np.testing.assert_allclose(values(head), before, atol=1e-4)


def test_another_bake_below_corrections_of_a_shot_that_begins_late_plays():
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.frame_start, scene.frame_end = 1001, 1100
    bake(head, start="scene")
    before = values(head, after=1000)
    assert np.ptp(before) > 0.1
    add_layer(head)
    np.testing.assert_allclose(values(head, after=1000), before, atol=1e-5)
    bake(head, start="scene")
    np.testing.assert_allclose(values(head, after=1000), before, atol=1e-4)


def test_a_loop_of_the_body_goes_on_below_corrections():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    armature, found = head.find_armature(), []
    bone = armature.pose.bones[0]
    for frame, x in ((1, 0.0), (13, 0.3), (25, 0.0)):
        bone.location.x = x
        bone.keyframe_insert("location", frame=frame, index=0)
    curves_of(armature)[0].modifiers.new("CYCLES")
    bake(head)
    add_layer(head)
    for frame in (37, 61, 13 + 240):
        bpy.context.scene.frame_set(frame)
        found.append(bone.location.x)
    assert found == pytest.approx([0.3, 0.3, 0.3], abs=1e-5)


def test_lashes_follow_corrections_of_the_skin():
    head = add_head(bpy.context, units=True)
    lashes = next(child for child in head.children if child.name.startswith("Lashes"))
    bake(head)
    add_layer(head)
    correct(head, "eyeBlinkLeft", 0.9)
    np.testing.assert_allclose(values(lashes, "eyeBlinkLeft"), values(head, "eyeBlinkLeft"), atol=1e-5)
    bake(head)
    np.testing.assert_allclose(values(lashes, "eyeBlinkLeft"), values(head, "eyeBlinkLeft"), atol=1e-5)
    assert values(lashes, "eyeBlinkLeft")[2] == pytest.approx(0.9, abs=1e-3)


def test_bones_are_corrected_and_their_bake_is_replaced_below():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    armature = head.find_armature()
    bake(head)
    add_layer(head)
    bone = armature.pose.bones["Head"]
    bpy.context.scene.frame_set(30)
    turned = bone.matrix_basis.copy()
    bone.location = (0.0, 0.0, 0.5)
    bone.keyframe_insert("location", frame=30)
    bake(head)
    bpy.context.scene.frame_set(30)
    assert bone.location.z == pytest.approx(0.5, abs=1e-4)
    assert bone.matrix_basis.to_quaternion().rotation_difference(turned.to_quaternion()).angle < 1e-3


def test_animation_of_the_user_goes_down_with_the_bake_and_stays_when_it_is_baked_again():
    head = add_head(bpy.context, units=True)
    bake(head)
    keys = head.data.shape_keys
    head.shape_key_add(name="Mine", from_mix=False)
    keys.key_blocks["Mine"].value = 0.3
    keys.key_blocks["Mine"].keyframe_insert("value", frame=1)
    keys.key_blocks["Mine"].value = 0.9
    keys.key_blocks["Mine"].keyframe_insert("value", frame=60)
    mine, jaw = values(head, "Mine"), values(head)
    add_layer(head)
    np.testing.assert_allclose(values(head, "Mine"), mine, atol=1e-5)
    np.testing.assert_allclose(values(head), jaw, atol=1e-5)
    bake(head)
    np.testing.assert_allclose(values(head, "Mine"), mine, atol=1e-5)
    np.testing.assert_allclose(values(head), jaw, atol=1e-4)


def test_a_head_without_a_bake_or_with_corrections_is_refused():
    head = add_head(bpy.context)
    with pytest.raises(HeadError, match="Bake a take"):
        add_layer(head)
    bake(head)
    add_layer(head)
    with pytest.raises(HeadError, match="corrections already"):
        add_layer(head)
    with pytest.raises(RuntimeError, match="corrections already"):
        bpy.ops.facemime.add_corrections()
    assert bpy.ops.facemime.remove_corrections() == {"FINISHED"} and not has_layer(head)


def test_curves_of_the_user_below_a_layer_are_not_mistaken_for_corrections():
    head = add_head(bpy.context, units=True)
    bake(head)
    add_layer(head)
    frames = np.arange(1.0, 61.0)
    curve = Curve('key_blocks["cheekPuff"].value', 0, np.linspace(0.0, 1.0, 60))
    write_curves(head.data.shape_keys, "Other", frames, [curve])
    assert head.data.shape_keys.animation_data.action.name.endswith("Corrections")


@pytest.mark.skipif(not hasattr(bpy.ops.anim, "merge_animation") or bpy.app.version < (4, 4), reason="no slots")
def test_corrections_that_were_merged_into_the_action_of_something_else_are_left_by_another_bake():
    head = add_head(bpy.context)
    bake(head)
    before = values(head)
    add_layer(head)
    correct(head)
    after = values(head)
    bpy.ops.object.camera_add()
    camera = bpy.context.active_object
    camera.keyframe_insert("location", frame=1)
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.anim.merge_animation()
    merged = camera.animation_data.action
    assert head.data.shape_keys.animation_data.action == merged and has_layer(head)
    assert not any("Muted" in warning for warning in bake(head).warnings)
    np.testing.assert_allclose(values(head), after, atol=1e-4)
    remove_layer(head)
    np.testing.assert_allclose(values(head), before, atol=1e-4)
    assert not has_layer(head) and camera.animation_data.action == merged
