"""Curves, drivers, tracks and shape keys that are switched off for a while, found again by name, and what a bake to
shape keys added and muted.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from .actions import baked_paths
from .characters import members_of
from .fcurves import action_name, curves_in, drivers_of, find_curve, slot_handle, tracks_of_bakes
from .meshes import mesh_of
from .muting import drivers_of_before
from .names import ASIDE_PROPERTY

Item = list[Any]
"""Kind, what identifies the item, and for some kinds the values to restore; JSON."""


def bake_of(owner: bpy.types.ID) -> list[Item]:
    """Return the curves and tracks that a bake wrote for `owner`."""
    baked = baked_paths(owner)
    return [*curves_of(owner, baked.__contains__), *(["track", track.name] for track in tracks_of_bakes(owner))]


def bake_of_keys(owner: bpy.types.Key) -> list[Item]:
    """Return what a bake did to shape keys: without it, the rig of their character moves the face as before.

    These are its curves, the keys that they move, and drivers that it muted, which play while they are aside.
    """
    before = drivers_of_before(owner)
    moved = baked_paths(owner).difference(driver.data_path for driver in before)
    names = [key.name for key in owner.key_blocks if key.path_from_id("value") in moved]
    released = (["released", driver.data_path, driver.array_index] for driver in before)
    return [*bake_of(owner), *keys(names), *released]


@contextmanager
def without_bake(head: bpy.types.Object) -> Iterator[None]:
    """Set aside what a bake did to the shape keys of a head for a while, in which Blender may handle events."""
    aside: list[tuple[int, Item]] = []
    for block in filter(None, (mesh_of(member.obj).shape_keys for member in members_of(head))):
        if block.library is None:
            aside += [(block.session_uid, item) for item in bake_of_keys(block) if switch(block, item, aside=True)]
    try:
        yield
    finally:
        there = {block.session_uid: block for block in bpy.data.shape_keys}
        for uid, item in aside:
            if uid in there:
                switch(there[uid], item, aside=False)


def driver_mutes(owner: bpy.types.ID) -> dict[tuple[str, int], bool]:
    """Return whether each driver of `owner` is muted by the user, and not only by a bake or a session."""
    items, before = listed(owner), drivers_of_before(owner)
    return {
        (curve.data_path, curve.array_index): curve.mute
        and curve not in before
        and ["driver", curve.data_path, curve.array_index] not in items
        for curve in drivers_of(owner)
    }


def curves_of(owner: bpy.types.ID, wanted: Callable[[str], bool]) -> list[Item]:
    """Return the curves of the active action of `owner` whose data paths are wanted."""
    if (data := owner.animation_data) is None:
        return []
    start = ["curve", action_name(data), slot_handle(data)]
    return [[*start, curve.data_path, curve.array_index] for curve in curves_in(data) if wanted(curve.data_path)]


def keys(names: Iterable[str]) -> list[Item]:
    """Return shape keys by name; their owner is the data-block of keys."""
    return [["key", name] for name in names]


def switch(owner: bpy.types.ID, item: Item, *, aside: bool) -> bool:
    """Set an item aside or restore it; return whether it was there, and not already so."""
    kind, *which = item
    found, mute = find(owner, kind, which), aside != (kind == "released")
    if found is None or found.mute == mute:
        return False
    found.mute = mute
    return True


def find(owner: bpy.types.ID, kind: str, which: list[Any]) -> Any:
    """Return a curve, driver, track or shape key; None if it was removed."""
    if kind == "key":
        assert isinstance(owner, bpy.types.Key)
        return owner.key_blocks.get(which[0])
    if kind == "curve":
        action = bpy.data.actions.get(which[0])
        return None if action is None else find_curve(action, *which[1:])
    if (data := owner.animation_data) is None:
        return None
    if kind == "track":
        return data.nla_tracks.get(which[0])
    return data.drivers.find(which[0], index=which[1])


def listed(owner: bpy.types.ID) -> list[Item]:
    """Return the items listed in a data-block, which users and add-ons may have edited."""
    try:
        items = json.loads(str(owner.get(ASIDE_PROPERTY, "[]")))
    except ValueError:
        return []
    return [item for item in items if isinstance(item, list) and item] if isinstance(items, list) else []
