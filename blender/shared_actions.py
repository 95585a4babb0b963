"""Actions that several characters share, of which one gets its own copy before its animation is changed."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from .fcurves import slot_handle


def make_actions_own(owners: Iterable[bpy.types.ID]) -> None:
    """Give data-blocks of a character a copy of each action that plays elsewhere too, or is linked.

    Data-blocks of the character that share an action also share its copy. Actions with slots are shared by what has the
    same slot only.

    Parameters
    ----------
    owners : iterable of bpy.types.ID
        All data-blocks whose animation will be changed.
    """
    playing = [(owner, data) for owner in dict.fromkeys(owners) if (data := owner.animation_data) is not None]
    animated = [owner for owner, data in playing if data.action is not None]
    copies: dict[tuple[bpy.types.Action, int], bpy.types.Action] = {}
    for _, data in playing:
        action, handle = data.action, slot_handle(data)
        if action is not None and (action, handle) not in copies and _plays_elsewhere(action, handle, animated):
            copies[action, handle] = action.copy()
    for _, data in playing:
        handle = slot_handle(data)
        if data.action is not None and (copy := copies.get((data.action, handle))) is not None:
            data.action = copy
            if handle:
                data.action_slot = next(slot for slot in copy.slots if slot.handle == handle)


def _plays_elsewhere(action: bpy.types.Action, handle: int, owners: list[bpy.types.ID]) -> bool:
    """Return whether a slot of an action plays on another data-block, or on a strip, or cannot be changed here."""
    if action.library is not None:
        return True
    for user in bpy.data.user_map(subset=[action])[action]:
        data = getattr(user, "animation_data", None)
        if data is None:
            continue
        if user not in owners and data.action == action and slot_handle(data) == handle:
            return True
        strips = (strip for track in data.nla_tracks for strip in track.strips)
        if any(strip.action == action and slot_handle(strip) == handle for strip in strips):
            return True
    return False
