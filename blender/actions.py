"""F-Curves written in bulk, in every Blender from 4.2 (legacy actions) to 5.x (slots and channel bags).

An action lists the curves that Facemime made, so that a second bake replaces these and never an animator's own.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.bake.clean import needed_keys
from ..core.errors import HeadError

TRACK = "Facemime"
"""Name of a bake's NLA tracks, numbered if there are several; a renamed track belongs to the user."""
_TRACK_NAME = re.compile(rf"{TRACK}(\.\d{{3}})?")
_OWNED = "facemime_curves"
"""Custom property of an action: the data paths of the curves that Facemime made, one per line."""
_KEYS = 'key_blocks["Facemime '
"""Prefix of the data paths of Facemime's shape keys."""


@dataclass(frozen=True)
class Curve:
    """An F-Curve to write.

    Attributes
    ----------
    data_path : str
    index : int
        Array index of the channel.
    values : (N,) array
        One value per frame.
    tolerance : float or None
        Error allowed when removing keyframes, in the unit of the values; None keeps all keyframes.
    """

    data_path: str
    index: int
    values: NDArray[np.floating]
    tolerance: float | None = None


def write_curves(
    owner: bpy.types.ID, name: str, frames: NDArray[np.floating], curves: Iterable[Curve], *, nla: bool = False
) -> None:
    """Animate a data-block with linear keyframes, replacing only curves that a bake wrote.

    Where the active action has a muted curve of someone else in the same channel, the new ones go onto an NLA track:
    an action has one curve per channel, and the muted one is kept.

    Parameters
    ----------
    owner : bpy.types.ID
    name : str
        Name of the action, if the owner has none.
    frames : (N,) array
        Frames of the keyframes.
    curves : iterable of Curve
    nla : bool
        Whether to put the curves into a new action on a new NLA track.
    """
    curves = list(curves)
    if not curves:
        return
    if nla or _muted_paths(owner).intersection(curve.data_path for curve in curves):
        _push(owner, name, frames, curves)
        return
    data = owner.animation_data or owner.animation_data_create()
    if data.action is None:
        data.action = bpy.data.actions.new(name)
    _fill(data.action, _fcurves(owner), frames, curves)


def check_curves(owner: bpy.types.ID, paths: Sequence[str]) -> None:
    """Check that channels can be animated.

    Parameters
    ----------
    owner : bpy.types.ID
    paths : sequence of str
        Data paths to be animated.

    Raises
    ------
    HeadError
        If one of them has animation or a driver that Facemime did not make.
    """
    data = owner.animation_data
    if data is None:
        return
    if taken := animated_paths(owner, paths):
        raise HeadError(
            f"{owner.name} already has animation in {taken[0]}, which the bake would replace. "
            "Remove it, or bake to something else."
        )


def animated_paths(owner: bpy.types.ID, paths: Sequence[str]) -> list[str]:
    """Return those of the data paths that have animation or a driver that Facemime did not make and that is not muted.

    Parameters
    ----------
    owner : bpy.types.ID
    paths : sequence of str
    """
    data = owner.animation_data
    if data is None:
        return []
    driven = {driver.data_path for driver in data.drivers if not driver.mute}
    animated = {curve.data_path for curve in curves_of(owner) if not curve.mute} - _owned(data.action)
    animated |= {path for strip in strips_of(owner) for path in _paths_in(strip)}
    return [path for path in paths if path in driven | animated and not path.startswith(_KEYS)]


def curve_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of all curves and drivers of `owner`, even of muted ones."""
    data = owner.animation_data
    return set() if data is None else {curve.data_path for curve in (*curves_of(owner), *data.drivers)}


def _paths_in(strip: bpy.types.NlaStrip) -> set[str]:
    """Return the data paths that a strip animates."""
    if strip.action is None:
        return set()
    return {
        curve.data_path for curve in _curves_in(strip.action, getattr(strip, "action_slot", None)) if not curve.mute
    }


def strips_of(owner: bpy.types.ID) -> list[bpy.types.NlaStrip]:
    """Return the NLA strips that play and that no bake wrote."""
    data = owner.animation_data
    if data is None or not data.use_nla:
        return []
    tracks = [track for track in data.nla_tracks if not track.mute]
    return [strip for track in tracks for strip in track.strips if not strip.mute and not _owned(strip.action)]


def _muted_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of muted curves in the active action that Facemime did not make."""
    data = owner.animation_data
    if data is None or data.action is None:
        return set()
    return {curve.data_path for curve in curves_of(owner) if curve.mute} - _owned(data.action)


def mute_paths(owner: bpy.types.ID, paths: Sequence[str]) -> int:
    """Mute the curves and drivers that `animated_paths` names, and return how many there were.

    Parameters
    ----------
    owner : bpy.types.ID
    paths : sequence of str
    """
    animated = animated_paths(owner, paths)
    found = [item for item in (*curves_of(owner), *owner.animation_data.drivers) if item.data_path in animated]
    for item in found:
        item.mute = True
    return len(found)


def remove_curves(owner: bpy.types.ID, prefix: str) -> None:
    """Remove the curves of `owner` whose data path starts with `prefix`.

    Parameters
    ----------
    owner : bpy.types.ID
    prefix : str
    """
    fcurves = curves_of(owner)
    for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path.startswith(prefix)]:
        fcurves.remove(fcurve)


def baked_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of all curves of `owner` that a bake wrote."""
    data = owner.animation_data
    if data is None:
        return set()
    actions = [data.action, *(strip.action for track in tracks_of(owner) for strip in track.strips)]
    return set().union(*(_owned(action) for action in actions))


def remove_bake(owner: bpy.types.ID) -> set[str]:
    """Remove all curves and strips of `owner` that a bake wrote, and return their data paths.

    A strip that the user added to a bake's track is kept, and so is the track.
    """
    removed, data = baked_paths(owner), owner.animation_data
    for track in tracks_of(owner):
        for strip in [strip for strip in track.strips if _owned(strip.action)]:
            track.strips.remove(strip)
        if not track.strips:
            data.nla_tracks.remove(track)
    if data is not None and (owned := _owned(data.action)):
        fcurves = curves_of(owner)
        for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path in owned]:
            fcurves.remove(fcurve)
        data.action[_OWNED] = ""
    return removed


def others_playing(owner: bpy.types.ID) -> list[str]:
    """Return the names of the action and the NLA tracks that animate `owner` in addition to a bake."""
    data = owner.animation_data
    if data is None:
        return []
    owned = _owned(data.action)
    action = [data.action.name] if any(not c.mute and c.data_path not in owned for c in curves_of(owner)) else []
    return action + [track.name for track in _othertracks_of(owner) if not track.mute]


def mute_others(owner: bpy.types.ID) -> int:
    """Mute the animation that `others_playing` names, and return how many curves and tracks were muted."""
    if owner.animation_data is None:
        return 0
    owned = _owned(owner.animation_data.action)
    found = [*(curve for curve in curves_of(owner) if curve.data_path not in owned), *_othertracks_of(owner)]
    playing = [item for item in found if not item.mute]
    for item in playing:
        item.mute = True
    return len(playing)


def _othertracks_of(owner: bpy.types.ID) -> list[bpy.types.NlaTrack]:
    """Return the NLA tracks with a strip that no bake wrote."""
    tracks = owner.animation_data.nla_tracks
    return [track for track in tracks if any(not _owned(strip.action) for strip in track.strips)]


def slot_of(owner: bpy.types.ID) -> int:
    """Return the handle of the slot of the owner's action, 0 if actions have no slots."""
    slot = getattr(owner.animation_data, "action_slot", None)
    return 0 if slot is None else int(slot.handle)


def find_curve(action: bpy.types.Action, handle: int, path: str, index: int) -> bpy.types.FCurve | None:
    """Return the curve in the channel bag of a slot; an action without slots has a single set of curves."""
    if not hasattr(action, "slots"):
        return action.fcurves.find(path, index=index)
    bags = (bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags)
    found = (bag.fcurves.find(path, index=index) for bag in bags if bag.slot_handle == handle)
    return next((curve for curve in found if curve is not None), None)


def tracks_of(owner: bpy.types.ID) -> list[bpy.types.NlaTrack]:
    """Return the NLA tracks of bakes."""
    data = owner.animation_data
    return [] if data is None else [track for track in data.nla_tracks if _TRACK_NAME.fullmatch(track.name)]


def _fill(action: bpy.types.Action, fcurves, frames: NDArray[np.floating], curves: Sequence[Curve]) -> None:
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    for curve in curves:
        if (old := fcurves.find(curve.data_path, index=curve.index)) is not None:
            fcurves.remove(old)
        points = np.column_stack([frames, curve.values])
        if curve.tolerance is not None:
            points = points[needed_keys(points[:, 0], points[:, 1], curve.tolerance)]
        fcurve = fcurves.new(curve.data_path, index=curve.index)
        fcurve.keyframe_points.add(len(points))
        fcurve.keyframe_points.foreach_set("co", points.astype(np.float32).reshape(-1))
        fcurve.keyframe_points.foreach_set("interpolation", np.full(len(points), linear, dtype=np.int32))
        fcurve.update()
    action[_OWNED] = "\n".join(sorted(_owned(action) | {curve.data_path for curve in curves}))


def _push(owner: bpy.types.ID, name: str, frames: NDArray[np.floating], curves: Sequence[Curve]) -> None:
    """Write the curves to a new action on a new track; the owner's active action is kept."""
    data = owner.animation_data or owner.animation_data_create()
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type=owner.id_type, name=owner.name) if hasattr(action, "slots") else None
    _fill(action, _fcurves_of(action, slot), frames, curves)
    track = data.nla_tracks.new()
    track.name = TRACK  # Blender numbers it if the name is taken: strips on one track must not overlap
    strip = track.strips.new(name, int(np.floor(frames[0])), action)
    if slot is not None:
        strip.action_slot = slot
    strip.action_frame_start, strip.action_frame_end = float(frames[0]), float(frames[-1])
    strip.frame_end, strip.frame_start = float(frames[-1]), float(frames[0])


def _owned(action: bpy.types.Action | None) -> set[str]:
    return set(filter(None, str(action.get(_OWNED, "")).split("\n"))) if action is not None else set()


def _fcurves(owner: bpy.types.ID):
    """Return the curves of the owner's action, which must exist; a slot is added if actions have slots."""
    data = owner.animation_data
    if hasattr(data.action, "slots") and data.action_slot is None:
        data.action_slot = data.action.slots.new(id_type=owner.id_type, name=owner.name)
    return _fcurves_of(data.action, data.action_slot if hasattr(data.action, "slots") else None)


def curves_of(owner: bpy.types.ID):
    """Return the curves of the owner's action, or an empty collection; nothing is created."""
    data = owner.animation_data
    if data is None or data.action is None:
        return ()
    return _curves_in(data.action, getattr(data, "action_slot", None))


def _curves_in(action: bpy.types.Action, slot):
    """Return the curves of a slot, or of an action without slots; nothing is created."""
    if not hasattr(action, "slots"):
        return action.fcurves
    if slot is None or not action.layers or not action.layers[0].strips:
        return ()
    bag = action.layers[0].strips[0].channelbag(slot)
    return () if bag is None else bag.fcurves


def _fcurves_of(action: bpy.types.Action, slot):
    if slot is None:
        return action.fcurves
    layer = action.layers[0] if action.layers else action.layers.new("Facemime")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves
