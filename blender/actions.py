"""Animation curves written in bulk, on every Blender from 4.2 (plain actions) to 5.x (slots and channel bags).

An action remembers which curves are ours, so that a second bake replaces them and an animator's own are never touched.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.bake.clean import needed_keys
from ..core.errors import HeadError

TRACK = "Facemime"
"""Name of the NLA track of a bake, numbered where it needs several; one that was renamed is the user's and stays."""
_TRACK_NAME = re.compile(rf"{TRACK}(\.\d{{3}})?")
_OWNED = "facemime_curves"
"""Custom property of an action: the data paths of our curves, a line each."""
_KEYS = 'key_blocks["Facemime '
"""What the paths of our shape keys begin with."""


@dataclass(frozen=True)
class Curve:
    """A curve to write.

    Attributes
    ----------
    data_path : str
    index : int
        Of the component.
    values : (N,) array
    tolerance : float or None
        How far the curve may be from `values` where keys are left out; None keeps them all.
    """

    data_path: str
    index: int
    values: NDArray[np.floating]
    tolerance: float | None = None


def write_curves(
    owner: bpy.types.ID, name: str, frames: NDArray[np.floating], curves: Iterable[Curve], *, nla: bool = False
) -> None:
    """Animate `owner` by `curves` with linear keys at `frames`, (N,), replacing curves of the same paths only.

    The owner's action is used where it has one, else one called `name` is made; other curves in it stay as they are.
    With `nla` the curves come into an action of their own, on a track of its own.
    """
    curves = list(curves)
    if not curves:
        return
    if nla:
        _push(owner, name, frames, curves)
        return
    data = owner.animation_data or owner.animation_data_create()
    if data.action is None:
        data.action = bpy.data.actions.new(name)
    _fill(data.action, _fcurves(owner), frames, curves)


def check_curves(owner: bpy.types.ID, paths: Sequence[str]) -> None:
    """Raise HeadError where one of `paths` of `owner` is animated or driven by somebody else, or cannot be animated."""
    data = owner.animation_data
    if data is None:
        return
    if data.action is not None and data.action.library is not None:
        raise HeadError(f"The animation {data.action.name} of {owner.name} is linked from another file. Make it local.")
    driven = {driver.data_path for driver in data.drivers}
    animated = {curve.data_path for curve in _existing(owner)} - _owned(data.action)
    if taken := [path for path in paths if path in driven | animated and not path.startswith(_KEYS)]:
        raise HeadError(
            f"{owner.name} has animation of its own in {taken[0]}, which the bake would replace. "
            "Remove that, or bake to something else."
        )


def remove_curves(owner: bpy.types.ID, prefix: str) -> None:
    """Remove the curves of `owner` whose data path starts with `prefix`."""
    fcurves = _existing(owner)
    for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path.startswith(prefix)]:
        fcurves.remove(fcurve)


def baked_paths(owner: bpy.types.ID) -> set[str]:
    """The data paths of all curves of `owner` that a bake wrote."""
    data = owner.animation_data
    if data is None:
        return set()
    actions = [data.action, *(strip.action for track in _tracks(owner) for strip in track.strips)]
    return set().union(*(_owned(action) for action in actions))


def remove_bake(owner: bpy.types.ID) -> set[str]:
    """Remove all curves of `owner` that an earlier bake wrote, and its track; returns their data paths."""
    removed, data = baked_paths(owner), owner.animation_data
    for track in _tracks(owner):
        data.nla_tracks.remove(track)
    if data is not None and (owned := _owned(data.action)):
        fcurves = _existing(owner)
        for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path in owned]:
            fcurves.remove(fcurve)
        data.action[_OWNED] = ""
    return removed


@dataclass(frozen=True)
class Muted:
    """A curve, track or shape key that was muted.

    It is looked up again when it is unmuted: Blender's pointer to it dies when the user removes it, and writing to that
    ends Blender.

    Attributes
    ----------
    find : callable
        Gives the thing, None where it was removed; may raise ReferenceError where the data-block it was in was deleted.
    """

    find: Callable[[], Any]

    @classmethod
    def all_of(cls, finds: Iterable[Callable[[], Any]]) -> list[Muted]:
        """Mute what `finds` find and is not muted yet."""
        audible = [find for find in finds if not find().mute]
        for find in audible:
            find().mute = True
        return [cls(find) for find in audible]

    def unmute(self) -> None:
        """Let it be heard again, if it is still there."""
        try:
            thing = self.find()
        except ReferenceError:
            return
        if thing is not None:
            thing.mute = False


def mute_curves(owner: bpy.types.ID, prefix: str) -> list[Muted]:
    """Mute the curves of `owner` whose data path starts with `prefix`; returns those that were not muted before."""
    return Muted.all_of(_curve_finders(owner, lambda path: path.startswith(prefix)))


def mute_bake(owner: bpy.types.ID) -> list[Muted]:
    """Mute what a bake wrote for `owner`; returns what was not muted before."""
    owned = _owned(owner.animation_data.action) if owner.animation_data is not None else set()
    tracks = [partial(_find_track, owner, track.name) for track in _tracks(owner)]
    return Muted.all_of([*_curve_finders(owner, owned.__contains__), *tracks])


def _curve_finders(owner: bpy.types.ID, wanted: Callable[[str], bool]) -> list[Callable[[], Any]]:
    data = owner.animation_data
    slot = getattr(data, "action_slot", None)
    handle = 0 if slot is None else slot.handle
    return [
        partial(_find_curve, data.action, handle, curve.data_path, curve.array_index)
        for curve in _existing(owner)
        if wanted(curve.data_path)
    ]


def _find_curve(action: bpy.types.Action, handle: int, path: str, index: int) -> bpy.types.FCurve | None:
    """The curve of the slot with that handle; actions without slots have one bag of curves."""
    if not hasattr(action, "slots"):
        return action.fcurves.find(path, index=index)
    bags = (bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags)
    found = (bag.fcurves.find(path, index=index) for bag in bags if bag.slot_handle == handle)
    return next((curve for curve in found if curve is not None), None)


def _find_track(owner: bpy.types.ID, name: str) -> bpy.types.NlaTrack | None:
    data = owner.animation_data
    return None if data is None else data.nla_tracks.get(name)


def _tracks(owner: bpy.types.ID) -> list[bpy.types.NlaTrack]:
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
    """Write the curves into an action of their own and put that on the track; the owner's action stays in place."""
    data = owner.animation_data or owner.animation_data_create()
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type=owner.id_type, name=owner.name) if hasattr(action, "slots") else None
    _fill(action, _fcurves_of(action, slot), frames, curves)
    track = data.nla_tracks.new()
    track.name = TRACK  # Blender numbers it where there is one: a track has room for one strip at a time
    strip = track.strips.new(name, int(np.floor(frames[0])), action)
    if slot is not None:
        strip.action_slot = slot
    strip.action_frame_start, strip.action_frame_end = float(frames[0]), float(frames[-1])
    strip.frame_end, strip.frame_start = float(frames[-1]), float(frames[0])


def _owned(action: bpy.types.Action | None) -> set[str]:
    return set(filter(None, str(action.get(_OWNED, "")).split("\n"))) if action is not None else set()


def _fcurves(owner: bpy.types.ID):
    """The curves of the owner's action, which it must have; with a slot for it where actions have slots."""
    data = owner.animation_data
    if hasattr(data.action, "slots") and data.action_slot is None:
        data.action_slot = data.action.slots.new(id_type=owner.id_type, name=owner.name)
    return _fcurves_of(data.action, data.action_slot if hasattr(data.action, "slots") else None)


def _existing(owner: bpy.types.ID):
    """The curves of the owner's action, none where it has no action; nothing is made."""
    data = owner.animation_data
    if data is None or data.action is None:
        return ()
    if not hasattr(data.action, "slots"):
        return data.action.fcurves
    if data.action_slot is None or not data.action.layers or not data.action.layers[0].strips:
        return ()
    bag = data.action.layers[0].strips[0].channelbag(data.action_slot)
    return () if bag is None else bag.fcurves


def _fcurves_of(action: bpy.types.Action, slot):
    if slot is None:
        return action.fcurves
    layer = action.layers[0] if action.layers else action.layers.new("Facemime")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves
