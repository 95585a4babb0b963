"""The keyframes of the last bake of shape keys, which *Detail* and the strengths of a head fit again for as long as
nobody has changed them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.numeric.arrays import FloatArray
from ..actions import baked_curves, rewrite_curves
from ..characters import Member, members_of
from ..meshes import mesh_of
from .bake_keys import RESIDUAL, KeyCurves, MeshKeys, value_path
from .refit_pose import ANGLE, LastPose
from .strengths import scaled


@dataclass(frozen=True)
class LastBake:
    """A bake of shape keys of a head.

    Attributes
    ----------
    head : str
        Name of the head.
    keys : MeshKeys
        The K keys.
    values : (N, K) array
        Their values before the strengths of the head.
    curves : KeyCurves
        Their curves as they were written.
    frames : (N,) array
        Whole frames of the values.
    unit : float
        Eye distance of the head, in its unit.
    pose : LastPose or None
        The pose of the head.
    """

    current: ClassVar[LastBake | None] = None

    head: str
    keys: MeshKeys
    values: FloatArray
    curves: KeyCurves
    frames: FloatArray
    unit: float
    pose: LastPose | None = None

    def is_untouched(self, members: Sequence[Member]) -> bool:
        """Whether all curves have the keyframes that the bake gave them."""
        columns = {value_path(name): column for column, name in enumerate(self.curves.names)}
        # Below corrections, keys that are corrected but not baked have curves, too.
        written = [fcurve for fcurve in _curves_of(members) if fcurve.data_path in columns]
        return bool(written) and all(
            np.array_equal(_points(fcurve), self._points(columns[fcurve.data_path])) for fcurve in written
        )

    def _points(self, column: int) -> NDArray[np.float32]:
        """Frames and values (P, 2) of the keyframes of a key."""
        fitted = self.curves.fitted[column]
        frames = self.frames if fitted is None else self.frames[fitted.rows]
        values = self.curves.values[:, column] if fitted is None else fitted.values
        return np.column_stack([frames, values]).astype(np.float32)


def _points(fcurve: bpy.types.FCurve) -> NDArray[np.float32]:
    flat = np.empty(2 * len(fcurve.keyframe_points), dtype=np.float32)
    fcurve.keyframe_points.foreach_get("co", flat)
    return flat.reshape(-1, 2)


def _keys_of(members: Sequence[Member]) -> list[bpy.types.Key]:
    return [keys for member in members if (keys := mesh_of(member.obj).shape_keys) is not None]


def _curves_of(members: Sequence[Member]) -> Iterator[bpy.types.FCurve]:
    """Yield the curves of the shape keys of a head that a bake wrote, also on NLA tracks and below corrections."""
    for keys in _keys_of(members):
        yield from baked_curves(keys)


def keyframe_count(head: bpy.types.Object) -> int:
    """Return the number of keyframes of the shape keys of a head that a bake wrote."""
    counts = {fcurve.data_path: len(fcurve.keyframe_points) for fcurve in _curves_of(members_of(head))}
    return sum(counts.values())


def refit(error: float) -> bool:
    """Fit the keyframes of the last bake again, with the strengths that its head has now.

    They stay within an error in eye distances; 0 gives each frame a keyframe.

    Return whether that was done: not if its head is gone, or a keyframe was changed.
    """
    last = LastBake.current
    if last is None or (head := bpy.data.objects.get(last.head)) is None or head.type != "MESH":
        return False
    members = members_of(head)
    if not last.is_untouched(members):
        return False
    residual = [name for name, group in last.curves.groups.items() if group == RESIDUAL]
    values = scaled(head, last.keys, last.values, last.frames, residual)
    curves = replace(last.curves, values=values).fitted_within(last.keys, error * last.unit)
    for owner in _keys_of(members):
        rewrite_curves(owner, last.frames, list(curves.to_write().values()))
    pose = last.pose
    if pose is not None:
        clean = (ANGLE * error, error * last.unit) if error > 0.0 else None
        pose = replace(pose, written=pose.fitted(head, clean, write=True))
    LastBake.current = replace(last, curves=curves, pose=pose)
    return True
