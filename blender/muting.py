"""Animation that a bake does not play together with: which there is, and how it is muted."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from contextlib import ExitStack
from typing import Any, NamedTuple

import bpy

from .fcurves import (
    Holder,
    action_name,
    content_of,
    content_of_track,
    curves_in,
    drivers_of,
    is_baked,
    is_layer,
    owned_paths,
    tracked_strips,
    tracks_of,
)
from .names import MUTED_PROPERTY

_KEYS = 'key_blocks["Facemime '
"""Prefix of the data paths of Facemime's shape keys."""
_CURVE, _DRIVER, _TRACK, _SOLO = "curve", "driver", "track", "solo"
_SHOWN = 3
"""Channels of an action that are named in a message."""


def animated_paths(owner: bpy.types.ID, paths: Iterable[str]) -> list[str]:
    """Return those of the data paths whose animation or driver is neither muted nor made by Facemime."""
    taken = driven_paths(owner) | keyed_paths(owner)
    return [path for path in paths if path in taken and not path.startswith(_KEYS)]


def driven_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of the drivers of `owner` that are not muted."""
    return {driver.data_path for driver in drivers_of(owner) if not driver.mute}


def keyed_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths that curves of the action and the NLA strips of `owner` move, without those of bakes."""
    return {path for holder in (owner.animation_data, *strips_of(owner)) for path in _moved_paths(holder)}


def varying_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths that curves of `owner` move to more than one value, of those of `keyed_paths`."""
    curves = [curve for holder in (owner.animation_data, *strips_of(owner)) for curve in curves_in(holder)]
    return {curve.data_path for curve in curves if _varies(curve)} & keyed_paths(owner)


def _varies(curve: bpy.types.FCurve) -> bool:
    values = [point.co[1] for point in curve.keyframe_points]
    return len(curve.modifiers) > 0 or max(values, default=0.0) > min(values, default=0.0)


def curve_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of the curves and strips of `owner` that play, or did before a bake muted them.

    Those of bakes do not count, nor do drivers: what these and muted curves move has the value that is shown.
    """
    data, noted = owner.animation_data, _lines(owner)
    tracks = [track for track in tracks_of(owner) if not track.mute or [_TRACK, track.name] in noted]
    holders = [data, *(strip for track in tracks for strip in track.strips if not strip.mute)]
    keyed = {
        curve.data_path
        for holder in holders
        for curve in curves_in(holder)
        if not curve.mute or [_CURVE, curve.data_path] in noted
    }
    return keyed.difference(owned_paths(data), *map(owned_paths, tracked_strips(owner)))


def strips_of(owner: bpy.types.ID) -> list[bpy.types.NlaStrip]:
    """Return the NLA strips that play and that no bake wrote."""
    data = owner.animation_data
    if data is None or not data.use_nla:
        return []
    tracks = [track for track in data.nla_tracks if not track.mute]
    return [strip for track in tracks for strip in track.strips if not strip.mute and not is_baked(strip)]


def muted_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of muted curves in the active action that Facemime did not make."""
    data = owner.animation_data
    return {curve.data_path for curve in curves_in(data) if curve.mute} - owned_paths(data)


class Silenced(NamedTuple):
    """A channel that was muted: what had moved it, and the name of what it moved; "" for all of it."""

    name: str
    moved: str


def name_them(silenced: Iterable[Silenced]) -> str:
    """Return what was muted as a text, with a few of the channels of each action."""
    groups: dict[str, dict[str, None]] = {}
    for name, moved in silenced:
        groups.setdefault(name, {}).update({moved: None} if moved else {})
    texts = []
    for name, every in groups.items():
        shown = [*every][:_SHOWN] + (["..."] if len(every) > _SHOWN else [])
        texts.append(f"{name} ({', '.join(shown)})" if shown else name)
    return ", ".join(texts)


def mute_paths(owner: bpy.types.ID, paths: Collection[str], *, curves: bool = True) -> list[Silenced]:
    """Mute the drivers and, by default, the curves of some data paths for a bake, and return what was muted.

    Strips below are not muted, as the bake replaces what they move.
    """
    data, muted = owner.animation_data, []
    owned = owned_paths(data)
    for curve in curves_in(data) if curves and not is_layer(data) else ():
        if curve.data_path in paths and not curve.mute and curve.data_path not in owned:
            muted.append((_CURVE, curve.data_path, action_name(data)))
            curve.mute = True
    for driver in drivers_of(owner):
        if driver.data_path in paths and not driver.mute:
            muted.append((_DRIVER, driver.data_path, owner.name))
            driver.mute = True
    return _noted(owner, muted)


def mute_others(owner: bpy.types.ID, paths: Collection[str] | None = None) -> list[Silenced]:
    """Mute curves and tracks of all or some data paths that a bake does not replace, and return what was muted.

    They stay muted until the next bake if `paths` are given.
    """
    data = owner.animation_data
    chosen = [path for path in sorted(_moved_paths(data)) if paths is None or path in paths]
    muted = [(_CURVE, path, action_name(data)) for path in chosen]
    for curve in curves_in(data):
        if curve.data_path in chosen:
            curve.mute = True
    for track in _other_tracks(owner):
        moved = set().union(*(_moved_paths(strip) for strip in track.strips))
        if not track.mute and (paths is None or moved.intersection(paths)):
            muted.append((_TRACK, track.name, track.name))
            track.mute = True
    return _noted(owner, muted) if paths is not None else _silenced(muted)


def end_solo(owner: bpy.types.ID) -> list[Silenced]:
    """Mute all tracks but one that plays alone, so that a bake can be seen beside it, and return what was muted.

    Curves of the active action, which it silenced as well, are muted, too.
    """
    data = owner.animation_data
    alone = next((track for track in tracks_of(owner) if track.is_solo), None)
    if data is None or alone is None:
        return []
    alone.is_solo = False
    others = [track for track in data.nla_tracks if track != alone and not track.mute]
    curves = [curve for curve in curves_in(data) if not curve.mute]
    for silent in (*others, *curves):
        silent.mute = True
    silenced = [(_TRACK, track.name, track.name) for track in others]
    silenced += [(_CURVE, curve.data_path, action_name(data)) for curve in curves]
    _noted(owner, [(_SOLO, alone.name, alone.name)])
    return _noted(owner, silenced)


def mute_for_now(stack: ExitStack, owner: bpy.types.ID, paths: Collection[str]) -> None:
    """Mute the curves of the action and the drivers of some data paths until a stack ends."""
    playing = (*curves_in(owner.animation_data), *drivers_of(owner))
    for curve in [curve for curve in playing if curve.data_path in paths and not curve.mute]:
        curve.mute = True
        stack.callback(setattr, curve, "mute", False)


def unmute_noted(owner: bpy.types.ID) -> None:
    """Unmute what bakes muted of the animation of `owner`."""
    lines = _lines(owner)
    if not lines:
        return
    paths = [(_CURVE, curve, curve.data_path) for curve in curves_in(owner.animation_data)]
    paths += [(_DRIVER, driver, driver.data_path) for driver in drivers_of(owner)]
    for kind, muted, name in (*paths, *((_TRACK, track, track.name) for track in tracks_of(owner))):
        if [kind, name] in lines:
            muted.mute = False
    for track in tracks_of(owner):
        if [_SOLO, track.name] in lines:
            track.is_solo = True
    del owner[MUTED_PROPERTY]


def drivers_of_before(owner: bpy.types.ID) -> list[bpy.types.FCurve]:
    """Return the drivers of `owner` that are muted because a bake muted them."""
    lines = _lines(owner)
    return [driver for driver in drivers_of(owner) if driver.mute and [_DRIVER, driver.data_path] in lines]


def _lines(owner: bpy.types.ID) -> list[list[str]]:
    """Return what bakes muted of `owner`: kinds, and data paths or names, as they are now if they were changed."""
    rows = [line.split(" ", 1) for line in str(owner.get(MUTED_PROPERTY, "")).split("\n") if line]
    lines = [(kind, *text.partition("\t")[::2]) for kind, text in rows]  # earlier versions noted no content
    there = _muted(owner) if any(content for *_, content in lines) else {}
    if all((kind, name) in there for kind, name, content in lines if content):
        return [[kind, name] for kind, name, _ in lines]
    left = {place: _content(muted) for place, muted in there.items() if place not in {line[:2] for line in lines}}
    found = []
    for kind, name, content in lines:
        renamed = [other for (same, other), mark in left.items() if same == kind and mark == content]
        found.append([kind, renamed[0] if content and (kind, name) not in there and renamed else name])
    return found


_Muted = list[Any]
"""Muted curves or drivers of a data path, or a track."""


def _muted(owner: bpy.types.ID) -> dict[tuple[str, str], _Muted]:
    """Return the muted curves, drivers and tracks of `owner` by kind, and data path or name."""
    found: dict[tuple[str, str], _Muted] = {}
    for kind, curves in ((_CURVE, curves_in(owner.animation_data)), (_DRIVER, drivers_of(owner))):
        for curve in curves:
            if curve.mute:
                found.setdefault((kind, curve.data_path), []).append(curve)
    return found | {(_TRACK, track.name): [track] for track in tracks_of(owner) if track.mute}


def _content(muted: _Muted) -> str:
    """Return a checksum of what has a data path or name."""
    return "".join(content_of(one) if isinstance(one, bpy.types.FCurve) else content_of_track(one) for one in muted)


def _noted(owner: bpy.types.ID, muted: list[tuple[str, str, str]]) -> list[Silenced]:
    """Note what was muted, so that the next bake finds it again, and return it."""
    if muted:
        there, rows = _muted(owner), [*_lines(owner), *([kind, path] for kind, path, _ in muted)]
        lines = (f"{kind} {path}\t{_content(there.get((kind, path), []))}".rstrip("\t") for kind, path in rows)
        owner[MUTED_PROPERTY] = "\n".join(dict.fromkeys(lines))
    return _silenced(muted)


def _silenced(muted: list[tuple[str, str, str]]) -> list[Silenced]:
    found = (Silenced(name, "" if kind == _TRACK else _label(path)) for kind, path, name in muted)
    return list(dict.fromkeys(found))


def _label(path: str) -> str:
    """Return the bone or the shape key of a data path, or otherwise the path."""
    named = re.search(r'\["(.*?)"\]', path)
    return bpy.utils.unescape_identifier(named[1]) if named else path


def others_playing(owner: bpy.types.ID) -> list[str]:
    """Return the names of the action and the NLA tracks that animate `owner` in addition to a bake."""
    data = owner.animation_data
    action = [action_name(data)] if _moved_paths(data) else []
    return action + [track.name for track in _other_tracks(owner) if not track.mute]


def _moved_paths(holder: Holder | None) -> set[str]:
    """Return the data paths of the curves of a holder that play and that Facemime did not make, nor corrects a bake."""
    if is_layer(holder):
        return set()
    return {curve.data_path for curve in curves_in(holder) if not curve.mute} - owned_paths(holder)


def _other_tracks(owner: bpy.types.ID) -> list[bpy.types.NlaTrack]:
    """Return the NLA tracks with a strip that no bake wrote."""
    return [track for track in tracks_of(owner) if any(not is_baked(strip) for strip in track.strips)]
