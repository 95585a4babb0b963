"""Animation curves written in bulk, on every Blender from 4.2 (plain actions) to 5.x (slots and channel bags)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Curve:
    """A curve to write: RNA `data_path`, `index` of the component, and its (N,) `values`."""

    data_path: str
    index: int
    values: NDArray[np.floating]


def write_curves(owner: bpy.types.ID, name: str, frames: NDArray[np.floating], curves: Iterable[Curve]) -> None:
    """Animate `owner` by `curves` with linear keys at `frames`, (N,), replacing curves of the same paths only.

    The owner's action is used where it has one, else one called `name` is made; other curves in it stay as they are.
    """
    curves = list(curves)
    fcurves = _fcurves(owner, name) if curves else None
    for curve in curves:
        if (old := fcurves.find(curve.data_path, index=curve.index)) is not None:
            fcurves.remove(old)
        fcurve = fcurves.new(curve.data_path, index=curve.index)
        fcurve.keyframe_points.add(len(frames))
        points = np.column_stack([frames, curve.values]).astype(np.float32).reshape(-1)
        fcurve.keyframe_points.foreach_set("co", points)
        linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
        fcurve.keyframe_points.foreach_set("interpolation", np.full(len(frames), linear, dtype=np.int32))
        fcurve.update()


def remove_curves(owner: bpy.types.ID, prefix: str) -> None:
    """Remove the curves of `owner` whose data path starts with `prefix`."""
    if owner.animation_data is None or owner.animation_data.action is None:
        return
    fcurves = _fcurves(owner, "")
    for fcurve in [fcurve for fcurve in fcurves if fcurve.data_path.startswith(prefix)]:
        fcurves.remove(fcurve)


def mute_curves(owner: bpy.types.ID, prefix: str) -> list[bpy.types.FCurve]:
    """Silence the curves of `owner` whose data path starts with `prefix`; returns those that were not silent before."""
    if owner.animation_data is None or owner.animation_data.action is None:
        return []
    audible = [fcurve for fcurve in _fcurves(owner, "") if fcurve.data_path.startswith(prefix) and not fcurve.mute]
    for fcurve in audible:
        fcurve.mute = True
    return audible


def _fcurves(owner: bpy.types.ID, name: str):
    data = owner.animation_data or owner.animation_data_create()
    if data.action is None:
        data.action = bpy.data.actions.new(name)
    action = data.action
    if not hasattr(action, "slots"):
        return action.fcurves
    if data.action_slot is None:
        data.action_slot = action.slots.new(id_type=owner.id_type, name=owner.name)
    layer = action.layers[0] if action.layers else action.layers.new("Facemime")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    return strip.channelbag(data.action_slot, ensure=True).fcurves
