"""Heads that are driven live by their own shape keys."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live_keys import live_keys
from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.characters import members_of
from facemime.blender.heads.built_in import add_head
from facemime.blender.names import PART_PROPERTY
from facemime.core.errors import HeadError
from facemime.sessions.start import follow_settings, start_session
from live_ticks import wait_for

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def character() -> bpy.types.Object:
    """A head with ARKit's keys that is not the built-in one."""
    head = add_head(bpy.context, units=True)
    for child in list(head.children):
        bpy.data.objects.remove(child)
    return head


def shown(head: bpy.types.Object) -> np.ndarray:
    """Displacements (V, 3) of the live shape key."""
    blocks = head.data.shape_keys.key_blocks
    flat = np.empty((2, 3 * len(head.data.vertices)), np.float32)
    for row, key in zip(flat, (blocks[LIVE_KEY], blocks[0]), strict=True):
        key.points.foreach_get("co", row)
    return (flat[0] - flat[1]).reshape(-1, 3)


def left_by_keys(head: bpy.types.Object) -> float:
    """Share of the displayed motion that no mix of the head's own keys explains."""
    keys = live_keys(head, "KEYS")
    member = members_of(head)[0]
    units = np.array([member.local_offsets(offsets).ravel() for offsets in keys.offsets.values()])
    moved = shown(head).ravel()
    mix = np.linalg.lstsq(units.T, moved, rcond=None)[0]
    return float(np.linalg.norm(moved - mix @ units) / np.linalg.norm(moved))


def play(session, head: bpy.types.Object) -> None:
    """Step until the mouth is open."""
    wait_for(
        lambda: session.step() and LIVE_KEY in head.data.shape_keys.key_blocks and np.abs(shown(head)).max() > 2e-3
    )


def test_a_character_with_known_keys_is_driven_by_them_or_by_its_skin_on_request(looping):
    head, scene = character(), bpy.context.scene
    session = start_session(scene, [head])
    play(session, head)
    assert left_by_keys(head) < 1e-3
    scene.facemime.drive_by = "SKIN"
    follow_settings(session, scene)
    wait_for(lambda: session.step() and left_by_keys(head) > 0.02)
    session.close()
    assert LIVE_KEY not in head.data.shape_keys.key_blocks


def test_the_built_in_head_is_driven_by_its_skin_unless_keys_are_requested():
    head = add_head(bpy.context, units=True)
    assert live_keys(head, "AUTOMATIC") is None and len(live_keys(head, "KEYS").offsets) > 40


def test_a_few_keys_are_not_taken_for_a_set():
    head = character()
    for key in [key for key in head.data.shape_keys.key_blocks[1:] if "Blink" in key.name]:
        head.shape_key_remove(key)
    assert live_keys(head, "AUTOMATIC") is None


def test_a_head_without_keys_cannot_be_driven_by_keys():
    head = add_head(bpy.context)
    assert PART_PROPERTY in head.children[0]
    with pytest.raises(HeadError, match="No key mapping preset"):
        live_keys(head, "KEYS")
