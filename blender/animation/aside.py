"""What is set aside while a session shows a performance: animation, shape keys and modifiers that would disturb it.

Each data-block lists its own in a custom property, so that an undo step taken during a session, a file that Blender
saved before it crashed, or a copy can be restored without the session; so do the values of shape keys. Items are found
again by name, as Python's reference to a curve or track becomes invalid when the user removes it.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence

import bpy

from ..characters import Member
from ..fcurves import (
    curves_in,
    drivers_of,
    is_baked,
    owned_paths,
    tracks_of,
)
from ..meshes import keys_of, mesh_of
from ..names import ASIDE_PROPERTY, VALUES_PROPERTY
from ..switching import Item, curves_of, driver_item, find, listed, switch, track_item
from .exporting import MODIFIER


def set_aside(owner: bpy.types.ID, items: Iterable[Item]) -> None:
    """Mute or disable items of a data-block, from the other functions here, and list those that were not.

    Does nothing to a linked data-block.
    """
    if owner.library is not None:
        return
    before = listed(owner)
    for item in items:
        if item not in before and _switch(owner, item, aside=True):
            before.append(item)
    if before:
        owner[ASIDE_PROPERTY] = json.dumps(before)


def restore(owner: bpy.types.ID) -> None:
    """Restore what was set aside of a data-block; may be called twice."""
    for item in listed(owner):
        _switch(owner, item, aside=False)
    owner.pop(ASIDE_PROPERTY, None)


def restore_all(but: Collection[bpy.types.ID] = ()) -> None:
    """Restore what was set aside of all data-blocks, except some."""
    for owner in (*bpy.data.objects, *bpy.data.shape_keys):
        if ASIDE_PROPERTY in owner and owner.library is None and owner not in but:
            restore(owner)


def moving(owner: bpy.types.ID, prefixes: Sequence[str]) -> list[Item]:
    """Return the curves, NLA tracks and drivers that move data paths of `owner` that start with a prefix."""
    starts = tuple(prefixes)
    driven = [driver for driver in drivers_of(owner) if driver.data_path.startswith(starts)]
    tracks = [
        track
        for track in tracks_of(owner)
        if any(curve.data_path.startswith(starts) for strip in track.strips for curve in curves_in(strip))
    ]
    return [
        *curves_of(owner, lambda path: path.startswith(starts)),
        *map(driver_item, driven),
        *map(track_item, tracks),
    ]


def values_aside(owner: bpy.types.ID, prefixes: Sequence[str], frame: float) -> dict[tuple[str, int], float]:
    """Return what the user's animation that is set aside would give some channels in a frame.

    Values are by data path and array index. Strips count at full influence, and add or replace. Drivers do not count.
    """
    values: dict[tuple[str, int], float] = {}
    starts, own, items = tuple(prefixes), owned_paths(owner.animation_data), listed(owner)
    muted = [find(owner, "track", which) for kind, *which in items if kind == "track"]
    for track in tracks_of(owner):
        if track in muted and (strip := _strip_at(track, frame)) is not None:
            at = strip.action_frame_start + (frame - strip.frame_start) / strip.scale
            at = min(max(at, strip.action_frame_start), strip.action_frame_end)
            for curve in curves_in(strip):
                if curve.data_path.startswith(starts):
                    place = curve.data_path, curve.array_index
                    below = values.get(place, 0.0) if strip.blend_type in ("ADD", "COMBINE") else 0.0
                    values[place] = below + curve.evaluate(at)
    for _, *which in (item for item in items if item[0] == "curve"):
        curve = find(owner, "curve", which)
        if curve is not None and curve.data_path.startswith(starts) and curve.data_path not in own:
            values[curve.data_path, curve.array_index] = curve.evaluate(frame)
    return values


def _strip_at(track: bpy.types.NlaTrack, frame: float) -> bpy.types.NlaStrip | None:
    """Return the user's strip that plays in a frame, or that holds the value before or after it."""
    strips = [strip for strip in track.strips if not is_baked(strip) and not strip.mute]
    begun = [strip for strip in strips if strip.frame_start <= frame]
    return begun[-1] if begun else next(iter(strips), None)


def display_of(obj: bpy.types.Object) -> list[Item]:
    """Return the cache of an object, and that it shows its active shape key alone."""
    cache = obj.modifiers.get(MODIFIER)
    shown: list[Item] = [] if cache is None else [["modifier", MODIFIER, cache.show_viewport, cache.show_render]]
    return [*shown, *([["solo"]] if obj.show_only_shape_key else [])]


def _switch(owner: bpy.types.ID, item: Item, *, aside: bool) -> bool:
    """Set an item aside or restore it; return whether it was there, and not already so."""
    kind, *which = item
    if kind == "solo":
        assert isinstance(owner, bpy.types.Object)
        changed, owner.show_only_shape_key = owner.show_only_shape_key == aside, not aside
        return bool(changed)
    if kind == "modifier":
        assert isinstance(owner, bpy.types.Object)
        name, in_viewport, in_render = which
        if (modifier := owner.modifiers.get(name)) is None:
            return False
        modifier.show_viewport = not aside and in_viewport
        modifier.show_render = not aside and in_render
        return bool(in_viewport or in_render)
    return switch(owner, item, aside=aside)


def resting_values(members: Sequence[Member], names: Sequence[str]) -> dict[str, float]:
    """Return the values of shape keys without what a session shows."""
    found: dict[str, float] = {}
    for obj in (member.obj for member in members if mesh_of(member.obj).shape_keys is not None):
        kept, blocks = kept_values(keys_of(obj)), keys_of(obj).key_blocks
        for name in names:
            if name in blocks:
                found.setdefault(name, kept.get(name, blocks[name].value))
    return found


def kept_values(keys: bpy.types.Key) -> dict[str, float]:
    """Return the values that shape keys had before a session, even one that ended in a crash."""
    try:
        values = json.loads(str(keys.get(VALUES_PROPERTY, "{}")))
    except ValueError:
        return {}
    found, blocks = {}, keys.key_blocks
    for name, kept in values.items():
        value, place = kept if isinstance(kept, list) and len(kept) == 2 else (kept, -1)  # earlier files have no place
        there, now = isinstance(place, int) and 0 <= place < len(blocks), name
        if name not in blocks and there and blocks[place].name not in values:
            now = blocks[place].name  # it was renamed
        if isinstance(value, (int, float)):
            found[now] = float(value)
    return found
