"""Animation written in bulk: keyframes on the active action or on an NLA track.

An action lists the curves that Facemime made, so that a second bake replaces these and never an animator's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.bake.bezier import BezierCurve
from ..core.bake.curves import fit_curves, stops_of
from ..core.errors import HeadError
from .fcurves import (
    TRACK,
    CharacterAction,
    Holder,
    curves_in,
    curves_to_fill,
    disown_paths,
    forget_contents,
    is_baked,
    own_paths,
    owned_paths,
    slot_handle,
    tracked_strips,
    tracks_of_bakes,
)
from .muting import Silenced, driven_paths, end_solo, keyed_paths, mute_paths, muted_paths, unmute_noted

_PEAK = 3.0
"""Height of a peak that is a keyframe, in errors."""

_FAR = 100_000.0
"""Frames by which a strip exceeds keyframes that repeat: an hour, in which Blender still tells fractions apart."""


@dataclass(frozen=True)
class Curve:
    """An F-Curve to write.

    Attributes
    ----------
    index : int
        Array index of the channel.
    values : (N,) array
        One value per frame.
    tolerance : float or None
        Error that fewer keyframes may cause, in the unit of the values, if the frames follow each other; None keeps one
        for each frame, with straight lines between.
    fitted : BezierCurve or None
        The keyframes, where they are known.
    group : str
        Name of the group of curves; "" for none.
    """

    data_path: str
    index: int
    values: NDArray[np.floating[Any]]
    tolerance: float | None = None
    fitted: BezierCurve | None = None
    group: str = ""


def write_curves(
    owner: bpy.types.ID,
    name: str,
    frames: NDArray[np.floating[Any]],
    curves: Iterable[Curve],
    *,
    action: CharacterAction | None = None,
    nla: bool = False,
    add: bool = False,
    leave_drivers: bool = False,
) -> list[Silenced]:
    """Animate a data-block with keyframes, replacing only curves that a bake wrote; return what was muted.

    What else moves the same channels is muted, or the curves are added to it. Where the active action has a muted curve
    of someone else in the same channel, or is itself added to what is below it, the new ones go onto an NLA track: an
    action has one curve per channel.

    Parameters
    ----------
    name : str
        Name of the action, if the owner has none, and it has its own.
    action : CharacterAction, optional
        The action of the character to which the owner belongs.
    frames : (N,) array
        Frames of the keyframes.
    nla : bool
        Whether to put the curves onto a new NLA track, in an action that all tracks of the character share.
    add : bool
        Whether to add to animation of the same channels instead of muting it.
    leave_drivers : bool
        Whether channels with a driver are left to it, instead of muting it.
    """
    left = driven_paths(owner) if leave_drivers else set()
    curves = [curve for curve in curves if curve.data_path not in left]
    if not curves:
        return []
    paths = {curve.data_path for curve in curves}
    silent = end_solo(owner)
    if add and (beneath := keyed_paths(owner) & paths):
        _push_down(owner, frames)
        action = action or CharacterAction(name, ())
        # What is added to no animation would be added to the default of the property, which is not always 0.
        for added in (True, False):
            if part := [curve for curve in curves if (curve.data_path in beneath) == added]:
                _push(owner, name, frames, part, action, add=added)
        return [*silent, *mute_paths(owner, paths, curves=False)]
    muted = [*silent, *mute_paths(owner, paths)]
    if nla or muted_paths(owner) & paths or _is_blended(owner):
        _push(owner, name, frames, curves, action or CharacterAction(name, ()))
        return muted
    data = owner.animation_data or owner.animation_data_create()
    if data.action is None:
        (action or CharacterAction(name, ())).give(owner, name)
    _fill(owner, data, frames, curves)
    return muted


def baked_holders(owner: bpy.types.ID) -> list[Holder]:
    """Return what plays the curves of bakes of a data-block: its active action, and strips, as below corrections."""
    data = owner.animation_data
    return [holder for holder in (data, *tracked_strips(owner)) if holder is not None and owned_paths(holder)]


def baked_curves(owner: bpy.types.ID) -> list[bpy.types.FCurve]:
    """Return the curves of a data-block that bakes wrote."""
    return [
        fcurve
        for holder in baked_holders(owner)
        for owned in (owned_paths(holder),)
        for fcurve in curves_in(holder)
        if fcurve.data_path in owned
    ]


def rewrite_curves(owner: bpy.types.ID, frames: NDArray[np.floating[Any]], curves: Sequence[Curve]) -> None:
    """Write curves again wherever a bake wrote those of the same channels."""
    for holder in baked_holders(owner):
        owned = owned_paths(holder)
        there = {(fcurve.data_path, fcurve.array_index) for fcurve in curves_in(holder) if fcurve.data_path in owned}
        _fill(owner, holder, frames, [curve for curve in curves if (curve.data_path, curve.index) in there])


def check_curves(owner: bpy.types.ID) -> None:
    """Raise HeadError if nothing can be animated, as a strip of `owner` is being tweaked."""
    data = owner.animation_data
    if data is not None and data.use_tweak_mode:
        raise HeadError(
            "A strip of {name} is in Tweak Mode. Leave Tweak Mode in the NLA Editor first.", name=owner.name
        )


def remove_curves(owner: bpy.types.ID, prefix: str) -> None:
    """Remove the curves of `owner` whose data path starts with `prefix`."""
    fcurves = curves_in(owner.animation_data)
    for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path.startswith(prefix)]:
        fcurves.remove(fcurve)


def baked_paths(owner: bpy.types.ID) -> set[str]:
    """Return the data paths of all curves of `owner` that a bake wrote."""
    return set().union(*(owned_paths(holder) for holder in (owner.animation_data, *tracked_strips(owner))))


def remove_bake(owner: bpy.types.ID) -> set[str]:
    """Remove all curves and strips of `owner` that a bake wrote, and return their data paths.

    A strip that the user added to a bake's track is kept, and so is the track. What the bake muted plays again.
    """
    removed, data = baked_paths(owner), owner.animation_data
    for track in tracks_of_bakes(owner):
        for strip in [strip for strip in track.strips if is_baked(strip)]:
            track.strips.remove(strip)
        if data is not None and not track.strips:
            track.is_solo = False  # otherwise nothing would play any more
            data.nla_tracks.remove(track)
    if data is not None and (owned := owned_paths(data)):
        fcurves = curves_in(data)
        for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path in owned]:
            fcurves.remove(fcurve)
        disown_paths(data)
    forget_contents(owner)
    unmute_noted(owner)
    return removed


def _fill(
    owner: bpy.types.ID,
    holder: bpy.types.AnimData | bpy.types.NlaStrip,
    frames: NDArray[np.floating[Any]],
    curves: Sequence[Curve],
) -> None:
    fcurves, groups = curves_to_fill(owner, holder)
    for curve, fitted in zip(curves, _fitted(curves), strict=True):
        if (old := fcurves.find(curve.data_path, index=curve.index)) is not None:
            fcurves.remove(old)
        fcurve = fcurves.new(curve.data_path, index=curve.index)
        if curve.group:
            fcurve.group = groups.get(curve.group) or groups.new(curve.group)
        if fitted is None:
            _add_points(fcurve, np.column_stack([frames, curve.values]), "LINEAR")
        else:
            _add_points(fcurve, np.column_stack([frames[fitted.rows], fitted.values]), "BEZIER")
            _shape(fcurve, fitted, frames)
        fcurve.update()
    own_paths(holder, (curve.data_path for curve in curves))


def _fitted(curves: Sequence[Curve]) -> list[BezierCurve | None]:
    """Return the curves with few keyframes; None for those with a keyframe in each frame."""
    found = [curve.fitted for curve in curves]
    rows = [row for row, curve in enumerate(curves) if curve.fitted is None and curve.tolerance is not None]
    if rows:
        values = np.column_stack([curves[row].values for row in rows])
        tolerances = np.array([curves[row].tolerance for row in rows], dtype=np.float64)
        stops = [stops_of(column, _PEAK * tolerance) for column, tolerance in zip(values.T, tolerances, strict=True)]
        free = np.full(len(rows), np.inf)
        for row, curve in zip(rows, fit_curves(values, tolerances, stops, -free, free), strict=True):
            found[row] = curve
    return found


def _number(kind: str, name: str) -> int:
    """Return the number of a value of an enumeration of keyframes, as `foreach_set` takes it."""
    enumeration = bpy.types.Keyframe.bl_rna.properties[kind]
    assert isinstance(enumeration, bpy.types.EnumProperty)
    return int(enumeration.enum_items[name].value)


def _add_points(fcurve: bpy.types.FCurve, points: NDArray[np.floating[Any]], interpolation: str) -> None:
    """Add keyframes (N, 2), frame and value, to a curve without any."""
    fcurve.keyframe_points.add(len(points))
    fcurve.keyframe_points.foreach_set("co", points.astype(np.float32).reshape(-1))
    kinds = np.full(len(points), _number("interpolation", interpolation), dtype=np.int32)
    fcurve.keyframe_points.foreach_set("interpolation", kinds)


def _shape(fcurve: bpy.types.FCurve, fitted: BezierCurve, frames: NDArray[np.floating[Any]]) -> None:
    """Give the keyframes of a curve over evenly spaced frames (N,) the handles of `fitted`."""
    spacing = (frames[-1] - frames[0]) / max(len(frames) - 1, 1) or 1.0
    kinds = np.where(fitted.smooth, _number("handle_left_type", "ALIGNED"), _number("handle_left_type", "FREE"))
    for side, handles in zip(("left", "right"), fitted.handles(), strict=True):
        fcurve.keyframe_points.foreach_set(f"handle_{side}_type", kinds.astype(np.int32))
        placed = (handles * (spacing, 1.0) + (frames[0], 0.0)).astype(np.float32)
        fcurve.keyframe_points.foreach_set(f"handle_{side}", placed.reshape(-1))


def _push(
    owner: bpy.types.ID,
    name: str,
    frames: NDArray[np.floating[Any]],
    curves: Sequence[Curve],
    action: CharacterAction,
    *,
    add: bool = False,
) -> None:
    """Write the curves to a new strip on a new track; the owner's active action is kept."""
    data = owner.animation_data or owner.animation_data_create()
    if not data.use_nla:  # the user has turned all tracks off
        for other in data.nla_tracks:
            other.mute = True
        data.use_nla = True
    track = data.nla_tracks.new()
    track.name = TRACK  # Blender numbers it if the name is taken: strips on one track must not overlap
    strip = action.add_strip(owner, track, int(np.floor(frames[0])), name)
    _fill(owner, strip, frames, curves)
    _span(strip, float(frames[0]), float(frames[-1]))
    if add:
        # Combine would subtract the default of a shape key's value, which is 1 from Blender 5.0 on.
        strip.blend_type = "ADD" if isinstance(owner, bpy.types.Key) else "COMBINE"


def sink_bake(owner: bpy.types.ID) -> None:
    """Put what the active action of a data-block has of a bake onto a track of bakes, above a track with the rest."""
    data = owner.animation_data
    if data is None or data.action is None:
        return
    baked, slot = owned_paths(data), slot_handle(data)
    every = {curve.data_path for curve in curves_in(data)}
    frames = np.array(data.action.frame_range[:])
    if not baked & every:
        _push_down(owner, frames)
        return
    action = data.action
    if every - baked:
        _play(data, action.copy(), slot)
        _keep_only(data, every - baked)
        disown_paths(data)
        _push_down(owner, frames)
        _play(data, action, slot)
        _keep_only(data, baked)
    _push_down(owner, frames, TRACK)


def _play(data: bpy.types.AnimData, action: bpy.types.Action, handle: int) -> None:
    """Let `data` play the slot of an action with a handle."""
    data.action = action
    if handle:
        data.action_slot = next(slot for slot in action.slots if slot.handle == handle)


def _keep_only(data: bpy.types.AnimData, paths: set[str]) -> None:
    fcurves = curves_in(data)
    for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path not in paths]:
        fcurves.remove(fcurve)


def _push_down(owner: bpy.types.ID, frames: NDArray[np.floating[Any]], name: str = "") -> None:
    """Put the active action onto a track of its own, which plays the same, so that others can be added to it.

    The track is named after the action by default.
    """
    data = owner.animation_data
    if data is None or data.action is None:
        return
    action, slot = data.action, getattr(data, "action_slot", None)
    # Blender disregards the extrapolation of an action that is above no strip.
    mode = data.action_extrapolation if any(track.strips for track in data.nla_tracks) else "HOLD"
    track = data.nla_tracks.new()
    track.name = name or action.name
    strip = track.strips.new(action.name, floor(action.frame_range[0]), action)
    if slot is not None:
        strip.action_slot = slot
    first, last = _played(data, mode, frames)
    _span(strip, float(floor(first)), float(ceil(last)))
    strip.blend_type, strip.extrapolation = data.action_blend_type, mode
    if data.action_influence < 1.0:
        strip.use_animated_influence, strip.influence = True, data.action_influence
    data.action = None


def _played(data: bpy.types.AnimData, mode: str, frames: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Return the first and the last frame of a strip that plays what the active action does, in `frames` too."""
    assert data.action is not None
    curves, first, last = curves_in(data), data.action.curve_frame_range[0], data.action.curve_frame_range[1]
    if mode == "NOTHING":
        last = max(last, first + 1.0)  # Blender's shortest strip
    else:
        first, last = min(first, frames[0]), max(last, frames[-1])
    repeats = any(len(curve.modifiers) for curve in curves)  # whatever the mode
    goes_on = any(curve.extrapolation == "LINEAR" for curve in curves)
    return (
        first - _FAR if repeats or (goes_on and mode == "HOLD") else first,
        last + _FAR if repeats or (goes_on and mode != "NOTHING") else last,
    )


def _span(strip: bpy.types.NlaStrip, first: float, last: float) -> None:
    """Let a strip play the frames of its action from `first` to `last` where they are."""
    strip.use_sync_length = False
    strip.action_frame_end = max(last, strip.action_frame_end)  # as Blender clips the start to it
    strip.action_frame_start, strip.action_frame_end = first, last
    strip.frame_end, strip.frame_start = last, first


def _is_blended(owner: bpy.types.ID) -> bool:
    """Return whether the active action does not simply replace what is below it."""
    data = owner.animation_data
    if data is None or data.action is None:
        return False
    return data.action_blend_type != "REPLACE" or data.action_influence < 1.0
