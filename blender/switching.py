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
from .fcurves import (
    Holder,
    action_name,
    content_of,
    content_of_track,
    curves_in,
    drivers_of,
    find_curve,
    slot_handle,
    tracks_of,
    tracks_of_bakes,
)
from .meshes import mesh_of
from .muting import drivers_of_before
from .names import ASIDE_PROPERTY

Item = list[Any]
"""Kind, what identifies the item, and for some kinds the values to restore; JSON.

Curves, drivers and tracks also have a checksum, and keys a place, by which those are found that were renamed meanwhile.
"""
_FIXED = {"key": 1, "curve": 4, "driver": 2, "released": 2, "track": 1}
"""How many values identify an item of a kind before it is renamed."""


def bake_of(owner: bpy.types.ID) -> list[Item]:
    """Return the curves and tracks that a bake wrote for `owner`."""
    baked = baked_paths(owner)
    return [*curves_of(owner, baked.__contains__), *map(track_item, tracks_of_bakes(owner))]


def bake_of_keys(owner: bpy.types.Key) -> list[Item]:
    """Return what a bake did to shape keys: without it, the rig of their character moves the face as before.

    These are its curves, the keys that they move, and drivers that it muted, which play while they are aside.
    """
    before = drivers_of_before(owner)
    moved = baked_paths(owner).difference(driver.data_path for driver in before)
    names = [key.name for key in owner.key_blocks if key.path_from_id("value") in moved]
    released = (["released", *driver_item(driver)[1:]] for driver in before)
    return [*bake_of(owner), *keys(owner, names), *released]


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
    others = drivers_of_before(owner)
    others += [find(owner, kind, which) for kind, *which in listed(owner) if kind == "driver"]
    return {(curve.data_path, curve.array_index): curve.mute and curve not in others for curve in drivers_of(owner)}


def curves_of(owner: bpy.types.ID, wanted: Callable[[str], bool]) -> list[Item]:
    """Return the curves of the active action of `owner` whose data paths are wanted."""
    if (data := owner.animation_data) is None:
        return []
    start = ["curve", action_name(data), slot_handle(data)]
    chosen = [curve for curve in curves_in(data) if wanted(curve.data_path)]
    return [[*start, curve.data_path, curve.array_index, content_of(curve)] for curve in chosen]


def driver_item(driver: bpy.types.FCurve) -> Item:
    """Return the item of a driver."""
    return ["driver", driver.data_path, driver.array_index, content_of(driver)]


def track_item(track: bpy.types.NlaTrack) -> Item:
    """Return the item of an NLA track."""
    return ["track", track.name, content_of_track(track)]


def keys(owner: bpy.types.Key, names: Iterable[str]) -> list[Item]:
    """Return items of shape keys by name."""
    return [["key", name, owner.key_blocks.find(name)] for name in names]


def switch(owner: bpy.types.ID, item: Item, *, aside: bool) -> bool:
    """Set an item aside or restore it; return whether it was there, and not already so."""
    kind, *which = item
    found, mute = find(owner, kind, which), aside != (kind == "released")
    if found is None or found.mute == mute:
        return False
    found.mute = mute
    return True


def find(owner: bpy.types.ID, kind: str, which: list[Any]) -> Any:
    """Return a curve, driver, track or shape key, also after it was renamed; None if it was removed."""
    fixed, more = which[: _FIXED[kind]], which[_FIXED[kind] :]
    found = _named(owner, kind, fixed)
    return _renamed(owner, kind, fixed, more[0]) if found is None and more else found


def _named(owner: bpy.types.ID, kind: str, fixed: list[Any]) -> Any:
    """Find an item by its name or data path."""
    if kind == "key":
        assert isinstance(owner, bpy.types.Key)
        return owner.key_blocks.get(fixed[0])
    if kind == "curve":
        name, *place = fixed
        played = [holder.action for holder in _holders(owner)]
        curves = [find_curve(action, *place) for action in (bpy.data.actions.get(name), *played) if action is not None]
        return next((curve for curve in curves if curve is not None), None)
    if (data := owner.animation_data) is None:
        return None
    return data.nla_tracks.get(fixed[0]) if kind == "track" else data.drivers.find(fixed[0], index=fixed[1])


def _renamed(owner: bpy.types.ID, kind: str, fixed: list[Any], mark: Any) -> Any:
    """Find an item that has another name or data path now by what does not change with these."""
    if kind == "key":
        assert isinstance(owner, bpy.types.Key)
        key = owner.key_blocks[mark] if 0 <= mark < len(owner.key_blocks) else None
        return None if key is None or ["key", key.name] in [item[:2] for item in listed(owner)] else key
    known = [item[1 : 1 + _FIXED[kind]] for item in listed(owner) if item[0] == kind]
    if kind == "track":
        tracks = [track for track in tracks_of(owner) if [track.name] not in known]
        return next((track for track in tracks if content_of_track(track) == mark), None)
    index = fixed[-1]
    paths = {tuple(one[-2:]) for one in known}
    curves = drivers_of(owner) if kind != "curve" else [one for holder in _holders(owner) for one in curves_in(holder)]
    left = [one for one in curves if one.array_index == index and (one.data_path, index) not in paths]
    return next((one for one in left if content_of(one) == mark), None)


def _holders(owner: bpy.types.ID) -> list[Holder]:
    """Return what plays actions of a data-block: itself, and strips."""
    strips = [strip for track in tracks_of(owner) for strip in track.strips]
    return [holder for holder in (owner.animation_data, *strips) if holder is not None]


def listed(owner: bpy.types.ID) -> list[Item]:
    """Return the items listed in a data-block, which users and add-ons may have edited."""
    try:
        items = json.loads(str(owner.get(ASIDE_PROPERTY, "[]")))
    except ValueError:
        return []
    return [item for item in items if isinstance(item, list) and item] if isinstance(items, list) else []
