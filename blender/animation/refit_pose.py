"""The pose curves of the last bake: *Detail* and strengths fit them again while nobody has changed them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.drive.driver import HeadMotion
from ...core.numeric.arrays import FloatArray
from ..actions import Curve, baked_curves, rewrite_curves
from .bake import Targets, part_curves, placements, posed_parts
from .strengths import scaled_pose
from .targets import Placement, PoseTarget

ANGLE = 0.4
"""Error of each angle in radians, for each eye distance that the curves may err: three of them turn a head by up to
0.7, and skin at about 1.3 eye distances from the neck moves as far as the curves may err.
"""
_Points = dict[tuple[str, int], NDArray[np.float32]]
"""Frames and values of keyframes, (P, 2), by data path and index."""


@dataclass(frozen=True)
class _Part:
    """What a bake poses: only names are kept, as references become invalid."""

    part: str
    obj: str
    head: str
    target: PoseTarget
    where: Placement

    def found(self) -> PoseTarget | None:
        """Return the target, if it still exists."""
        obj, head = bpy.data.objects.get(self.obj), bpy.data.objects.get(self.head) if self.head else None
        if obj is None or (self.head and head is None):
            return None
        target = replace(self.target, obj=obj, head=head)
        return target if target.exists else None


@dataclass(frozen=True)
class LastPose:
    """The pose of a bake of a head.

    Attributes
    ----------
    parts : tuple
        What is posed.
    motion : HeadMotion
        The motion in the frames of the keyframes, before the strengths of the head.
    frames : (N,) array
    follow : (bool, bool)
        Whether the head follows rotation and translation.
    written : dict
        The keyframes as they were written, by the name of what they animate.
    """

    parts: tuple[_Part, ...]
    motion: HeadMotion
    frames: FloatArray
    follow: tuple[bool, bool]
    written: dict[str, _Points]

    @classmethod
    def of(
        cls,
        scene: bpy.types.Scene,
        head: bpy.types.Object,
        targets: Targets,
        motion: HeadMotion,
        frames: FloatArray,
        follow: tuple[bool, bool],
    ) -> LastPose:
        """Return the pose of a head that was just baked."""
        posed = posed_parts(head, targets)
        placed = placements(scene, [target for _, target in posed], frames, keep=False)
        parts = tuple(
            _Part(part, target.obj.name, "" if target.head is None else target.head.name, target, where)
            for (part, target), where in zip(posed, placed, strict=True)
        )
        last = cls(parts, motion, frames, follow, {})
        return replace(last, written=last.fitted(head, None))

    def fitted(
        self, head: bpy.types.Object, clean: tuple[float, float] | None, *, write: bool = False
    ) -> dict[str, _Points]:
        """Write curves that nobody has changed again, if `write` is set, and return all keyframes."""
        motion, found = scaled_pose(head, self.motion, self.frames) if write else self.motion, dict[str, _Points]()
        for name, curves in self._curves(motion, clean):
            owner = bpy.data.objects[name]
            keys = {(curve.data_path, curve.index) for curve in curves}
            there = _points_of(owner, keys)
            if write and _same(there, self.written.get(name, {})):
                rewrite_curves(owner, self.frames, curves)
                there = _points_of(owner, keys)
            elif write:
                there = self.written.get(name, {})
            found[name] = there
        return found

    def _curves(self, motion: HeadMotion, clean: tuple[float, float] | None) -> Iterator[tuple[str, list[Curve]]]:
        """Yield the names of the objects that are posed, and the curves of each."""
        curves: dict[str, list[Curve]] = {}
        rotation, translation = self.follow
        for part in self.parts:
            if (target := part.found()) is not None:
                how = {"rotation": rotation, "translation": translation}
                curves.setdefault(part.obj, []).extend(part_curves(part.part, target, motion, clean, part.where, **how))
        yield from ((name, own) for name, own in curves.items() if own)


def _points_of(owner: bpy.types.Object, keys: set[tuple[str, int]]) -> _Points:
    """Return the keyframes of curves that a bake wrote for an object."""
    found: _Points = {}
    for fcurve in baked_curves(owner):
        if (key := (fcurve.data_path, fcurve.array_index)) in keys:
            flat = np.empty(2 * len(fcurve.keyframe_points), dtype=np.float32)
            fcurve.keyframe_points.foreach_get("co", flat)
            found[key] = flat.reshape(-1, 2)
    return found


def _same(one: _Points, other: _Points) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)
