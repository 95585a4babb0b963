"""Animation of shape keys that plays together with a bake is reported, and muted on request."""

from __future__ import annotations

import bpy
import pytest

from facemime.blender.actions import curves_of
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.underneath import mute_under, playing_under
from facemime.blender.heads.built_in import add_head
from takes import performance


@pytest.fixture
def head():
    """A head with an idle animation of one of its own keys."""
    head = add_head(bpy.context)
    head.shape_key_add(name="Basis")
    key = head.shape_key_add(name="idle")
    for frame, value in ((1, 0.0), (10, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    head.data.shape_keys.animation_data.action.name = "Idle"
    return head


def value_at(head: bpy.types.Object, frame: int) -> float:
    bpy.context.scene.frame_set(frame)
    return head.data.shape_keys.key_blocks["idle"].value


def test_an_action_under_a_bake_is_reported_and_muted_while_the_bake_plays(head):
    report = puppet_head(bpy.context.scene, head, performance())
    assert report.others == ("Idle",) and any("Idle" in warning for warning in report.warnings)
    assert mute_under(head) == 1 and playing_under(head) == []
    before = value_at(head, 2)
    assert value_at(head, 8) == before, "the idle key stands still"
    curves = {curve.data_path: curve for curve in curves_of(head.data.shape_keys)}
    assert curves['key_blocks["idle"].value'].mute
    assert len(curves) > 1 and not any(curve.mute for path, curve in curves.items() if "idle" not in path)


def test_the_users_strip_is_muted_and_that_of_a_bake_is_not(head):
    data = head.data.shape_keys.animation_data
    data.nla_tracks.new().strips.new("Idle", 1, data.action)
    data.action = None
    data.nla_tracks[0].name = "Imported"
    from facemime.core.bake.settings import BakeSettings
    from facemime.core.puppet.settings import PuppetSettings

    puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(nla=True)))
    assert playing_under(head) == ["Imported"]
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.mute_others() == {"FINISHED"}
    assert {track.name: track.mute for track in data.nla_tracks} == {"Imported": True, "Facemime": False}


def test_without_other_animation_nothing_is_reported():
    head = add_head(bpy.context)
    report = puppet_head(bpy.context.scene, head, performance())
    assert report.others == () and mute_under(head) == 0
