"""Curves of a bake are known as its own, whatever Blender does to the action, the slot and the names of keys."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.bake import remove_baked
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance

SLOTS = pytest.mark.skipif(bpy.app.version < (4, 4), reason="actions have no slots")


@pytest.fixture
def head():
    return add_head(bpy.context, units=True)


def bake(head):
    report = puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(keys="mapped")))
    return [warning for warning in report.warnings if "Muted" in warning or "Other animation" in warning]


def shown(head):
    """Values of the keys and placement of the head in a frame."""
    bpy.context.scene.frame_set(40)
    graph = bpy.context.evaluated_depsgraph_get()
    placed = np.array(head.evaluated_get(graph).matrix_world).ravel()
    return np.array([*placed, *(key.value for key in head.data.shape_keys.key_blocks)])


def _merge(head):
    """Merge the animation of the head into that of another object."""
    other = bpy.data.objects.new("Body", None)
    bpy.context.scene.collection.objects.link(other)
    other.keyframe_insert("location", frame=1)
    bpy.ops.object.select_all(action="DESELECT")
    for obj in (head, other):
        obj.select_set(True)
    bpy.context.view_layer.objects.active = other
    assert bpy.ops.anim.merge_animation() == {"FINISHED"}
    assert head.animation_data.action == other.animation_data.action


def _separate(head):
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.anim.separate_slots() == {"FINISHED"}
    assert head.animation_data.action != head.data.shape_keys.animation_data.action


def _edit(head):
    curves_of(head.data.shape_keys)[3].keyframe_points[0].co.y += 0.1
    curves_of(head)[0].keyframe_points[0].co.y += 0.1


def _rename(head):
    for keys in bpy.data.shape_keys:
        if (key := keys.key_blocks.get("jawOpen")) is not None:
            key.name = "JawOpen"


@pytest.mark.parametrize(
    "changes",
    [
        (_rename,),
        pytest.param((_merge,), marks=SLOTS),
        pytest.param((_separate,), marks=SLOTS),
        pytest.param((_edit, _merge, _separate), marks=SLOTS),
        pytest.param((_merge, _rename), marks=SLOTS),
    ],
    ids=lambda changes: " ".join(change.__name__[1:] for change in changes),
)
def test_another_bake_replaces_curves_that_blender_moved_or_renamed(head, changes):
    bake(head)
    before = shown(head)
    for change in changes:
        change(head)
    assert bake(head) == []
    owners = (head, head.data.shape_keys)
    assert not any(len(owner.animation_data.nla_tracks) for owner in owners)
    assert not any(curve.mute for owner in owners for curve in curves_of(owner))
    np.testing.assert_allclose(shown(head), before, atol=1e-5)
    remove_baked(head, own_targets(head))
    assert not any(len(curves_of(owner)) for owner in owners)


def test_an_action_of_the_users_in_place_of_that_of_a_bake_is_not_taken_for_it(head):
    bake(head)
    keys = head.data.shape_keys
    keys.animation_data.action = bpy.data.actions.new("Mine")
    for frame in (1, 60):
        keys.key_blocks["jawOpen"].keyframe_insert("value", frame=frame)
    assert bake(head) != []
    assert any(curve.data_path == 'key_blocks["jawOpen"].value' and curve.mute for curve in curves_of(keys))
