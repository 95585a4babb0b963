"""How far constraints let a control move that limit it in other axes than its channels'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from ...core.rigs.rig_map import LOCATION, ROTATION, RigChannel
from .setting import Holder, holder_of

_LIMITING = {LOCATION: {"LIMIT_LOCATION", "LIMIT_DISTANCE"}, ROTATION: {"LIMIT_ROTATION"}}
"""Constraints that limit each kind of channel."""
_NEAR = {LOCATION: 0.01, ROTATION: np.radians(0.5)}
"""Change from rest at which a control is taken to move freely: in eye distances, and radians."""
_FAR = {LOCATION: 1.0, ROTATION: np.radians(60.0)}
"""Change from rest beyond which limits do not count: twice as far as a control without limits is moved."""
_FREE = 0.98
"""Share of a free motion above which a control is not limited."""


def limited(channel: RigChannel, write: Callable[[float], object]) -> RigChannel:
    """Return a channel with the limits that constraints in the axes of the world, of the armature or of others give it.

    `write` sets the channel to a change from rest, and every other one to rest.
    """
    if channel.kind not in _LIMITING or np.isfinite([channel.low, channel.high]).all():
        return channel
    holder = holder_of(channel.owner, channel.bone)
    if not any(one.type in _LIMITING[channel.kind] and _acts(one) for one in holder.constraints):
        return channel
    low, high = channel.low, channel.high
    if np.isinf(low):
        low = -_reach(channel, holder, lambda far: write(-far))
    if np.isinf(high):
        high = _reach(channel, holder, write)
    write(0.0)
    return replace(channel, low=low, high=high)


def _reach(channel: RigChannel, holder: Holder, write: Callable[[float], object]) -> float:
    """Return how far a channel moves its control; infinite if nothing limits it."""
    unit = channel.unit if channel.kind == LOCATION else 1.0
    near, far = _NEAR[channel.kind] * unit, _FAR[channel.kind] * unit
    places = []
    for value in (0.0, near, far):
        write(value)
        bpy.context.view_layer.update()
        places.append((holder.matrix if isinstance(holder, bpy.types.PoseBone) else holder.matrix_world).copy())
    freely, most = (_difference(channel.kind, places[0], place) for place in places[1:])
    if most >= _FREE * freely * far / near and freely > 0.0:
        return np.inf
    return near * most / freely if freely > 0.0 else 0.0


def _difference(kind: str, before: Matrix, after: Matrix) -> float:
    """Return the distance, or the angle, between two transforms."""
    if kind == LOCATION:
        return float((after.translation - before.translation).length)
    return float(before.to_quaternion().rotation_difference(after.to_quaternion()).angle)


def _acts(constraint: bpy.types.Constraint) -> bool:
    return not constraint.mute and constraint.influence > 0.0
