"""What is set aside while a session shows a performance: animation, shape keys and modifiers that would disturb it.

Each data-block lists its own in a custom property, so that an undo step taken during a session, a file that Blender
saved before it crashed, or a copy can be restored without the session. Items are found again by name, as Python's
reference to a curve or track becomes invalid when the user removes it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import bpy

from ..actions import baked_paths
from ..fcurves import curves_in, find_curve, slot_handle
from ..names import ASIDE_PROPERTY
from ..tracks import tracks_of_bakes
from .bake_cache import MODIFIER

Item = list[Any]
"""Kind, what identifies the item, and for some kinds the values to restore; JSON."""


def set_aside(owner: bpy.types.ID, items: Iterable[Item]) -> None:
    """Mute or disable items of a data-block, and list those that were not; does nothing to a linked one.

    Parameters
    ----------
    owner : bpy.types.ID
    items : iterable of Item
        As the other functions here return them.
    """
    if owner.library is not None:
        return
    listed = _listed(owner)
    for item in items:
        if item not in listed and _switch(owner, item, aside=True):
            listed.append(item)
    if listed:
        owner[ASIDE_PROPERTY] = json.dumps(listed)


def restore(owner: bpy.types.ID) -> None:
    """Restore what was set aside of a data-block; may be called twice."""
    for item in _listed(owner):
        _switch(owner, item, aside=False)
    owner.pop(ASIDE_PROPERTY, None)


def restore_all() -> None:
    """Restore what was set aside of all data-blocks, after an undo or when a file was opened."""
    for owner in _owners():
        if ASIDE_PROPERTY in owner and owner.library is None:
            restore(owner)


def curves(owner: bpy.types.ID, wanted: Callable[[str], bool]) -> list[Item]:
    """Return the curves of the active action of `owner` in the data paths that `wanted` accepts."""
    if not (found := [curve for curve in curves_in(owner.animation_data) if wanted(curve.data_path)]):
        return []
    action, slot = owner.animation_data.action, slot_handle(owner.animation_data)
    return [["curve", action.name, slot, curve.data_path, curve.array_index] for curve in found]


def drivers(owner: bpy.types.ID, wanted: Callable[[bpy.types.FCurve], bool]) -> list[Item]:
    """Return the drivers of `owner` that `wanted` accepts."""
    data = owner.animation_data
    found = [] if data is None else [driver for driver in data.drivers if wanted(driver)]
    return [["driver", driver.data_path, driver.array_index] for driver in found]


def bake_of(owner: bpy.types.ID) -> list[Item]:
    """Return the curves and tracks that a bake wrote for `owner`."""
    baked = baked_paths(owner)
    return [*curves(owner, baked.__contains__), *(["track", track.name] for track in tracks_of_bakes(owner))]


def keys(names: Iterable[str]) -> list[Item]:
    """Return shape keys by name; their owner is the data-block of keys."""
    return [["key", name] for name in names]


def display_of(obj: bpy.types.Object) -> list[Item]:
    """Return the cache of an object, and that it shows its active shape key alone."""
    cache = obj.modifiers.get(MODIFIER)
    shown = [] if cache is None else [["modifier", MODIFIER, cache.show_viewport, cache.show_render]]
    return [*shown, *([["solo"]] if obj.show_only_shape_key else [])]


def _switch(owner: bpy.types.ID, item: Item, *, aside: bool) -> bool:
    """Set an item aside or restore it; return whether it was there, and not already so."""
    kind, *which = item
    if kind == "solo":
        changed, owner.show_only_shape_key = owner.show_only_shape_key == aside, not aside
        return bool(changed)
    if kind == "modifier":
        name, in_viewport, in_render = which
        if (modifier := owner.modifiers.get(name)) is None:
            return False
        modifier.show_viewport = not aside and in_viewport
        modifier.show_render = not aside and in_render
        return bool(in_viewport or in_render)
    found = _find(owner, kind, which)
    if found is None or found.mute == aside:
        return False
    found.mute = aside
    return True


def _find(owner: bpy.types.ID, kind: str, which: list[Any]) -> Any:
    """Return a curve, driver, track or shape key; None if it was removed."""
    if kind == "key":
        return owner.key_blocks.get(which[0])
    if kind == "curve":
        action = bpy.data.actions.get(which[0])
        return None if action is None else find_curve(action, *which[1:])
    if (data := owner.animation_data) is None:
        return None
    if kind == "track":
        return data.nla_tracks.get(which[0])
    return data.drivers.find(which[0], index=which[1])


def _listed(owner: bpy.types.ID) -> list[Item]:
    """Return the items listed in a data-block, which users and add-ons may have edited."""
    try:
        items = json.loads(str(owner.get(ASIDE_PROPERTY, "[]")))
    except ValueError:
        return []
    return [item for item in items if isinstance(item, list) and item] if isinstance(items, list) else []


def _owners() -> Iterator[bpy.types.ID]:
    yield from bpy.data.objects
    yield from bpy.data.shape_keys
