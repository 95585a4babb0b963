"""Where the joints of Rigify's human metarig are in a face, from its landmarks (method.md, section 9.8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..face.landmarks import MIRROR, from_ibug
from ..mesh.kernels import Warp
from ..numeric.arrays import FloatArray

Joint = tuple[str, str]
"""A bone, and "head" or "tail"."""
_UPPER_LID, _LOWER_LID = (45, 44, 43, 42), (42, 47, 46, 45)
"""Landmarks of the left eye, from the outer corner to the inner one, and back, by iBUG number."""
_QUARTERS = (0.75, 1.5, 2.25)
"""Places of the joints between, in landmarks from the first one."""


@dataclass(frozen=True)
class FaceShape:
    """What places the joints of a face, in the head frame.

    Attributes
    ----------
    landmarks : (66, 3) array
    jaw_pivot : (3,) array
    eyes : (2, 3) array
        Centres of the right and the left eyeball.
    """

    landmarks: FloatArray
    jaw_pivot: FloatArray
    eyes: FloatArray


class MetarigFit:
    """A map from the space of a metarig to that of a face: exact at the joints that landmarks place.

    Parameters
    ----------
    joints : mapping of Joint to (3,) array
        Joints of the metarig in the head frame: x to the head's left, y down, z back.
    shape : FaceShape
    """

    def __init__(self, joints: Mapping[Joint, FloatArray], shape: FaceShape) -> None:
        placed = {joint: place for joint, place in joints_of(shape).items() if joint in joints}
        source, target = (np.array([each[joint] for joint in placed]) for each in (joints, placed))
        self.placed = placed
        unique = np.unique(np.round(source, 5), axis=0, return_index=True)[1]
        source, target = source[unique], target[unique]
        self._warp = Warp(source, target, smoothing=0.0)
        self._scale = float(np.linalg.norm(target - target.mean(axis=0)) / np.linalg.norm(source - source.mean(axis=0)))
        self._middles = source.mean(axis=0), target.mean(axis=0)

    def face(self, points: FloatArray) -> FloatArray:
        """Carry joints of the face, (N, 3), over."""
        return self._warp(points)

    def body(self, points: FloatArray) -> FloatArray:
        """Carry joints of neck and spine, (N, 3), over by a similarity."""
        source, target = self._middles
        return np.asarray(self._scale * (points - source) + target)


def joints_of(shape: FaceShape) -> dict[Joint, FloatArray]:
    """Return the joints that landmarks place, of both sides and of the middle."""
    found = _side(shape, left=True)
    for (bone, end), place in _side(shape, left=False).items():
        found[bone.replace(".L", ".R"), end] = place
    return {**found, **_middle(shape)}


def _side(shape: FaceShape, *, left: bool) -> dict[Joint, FloatArray]:
    """Return the joints of a side, with the names of the left one."""
    points = shape.landmarks if left else shape.landmarks[MIRROR]

    def at(*numbers: int) -> FloatArray:
        return np.asarray(points[from_ibug(numbers)].mean(axis=0))

    upper, lower = ([at(number) for number in lid] for lid in (_UPPER_LID, _LOWER_LID))
    joints = {("lid.T.L", "head"): at(45), ("lid.B.L", "head"): at(42), ("eye.L", "head"): shape.eyes[int(left)]}
    for number, place in enumerate(_QUARTERS, 1):
        joints[f"lid.T.L.00{number}", "head"] = _between(upper, place)
        joints[f"lid.B.L.00{number}", "head"] = _between(lower, place)
    joints |= {
        ("brow.T.L.001", "head"): at(26),
        ("brow.T.L.002", "head"): at(24, 25),
        ("brow.T.L.003", "head"): at(22),
        ("brow.B.L", "head"): _mix(at(45), at(26), 0.4),
        ("brow.B.L.001", "head"): _mix(_between(upper, 0.75), at(25, 26), 0.5),
        ("brow.B.L.002", "head"): _mix(_between(upper, 1.5), at(24), 0.5),
        ("brow.B.L.003", "head"): _mix(_between(upper, 2.25), at(23), 0.5),
        ("brow.B.L.003", "tail"): _mix(at(42), at(22), 0.45),
        ("nose.L.001", "head"): at(35),
        ("lip.T.L.001", "head"): at(53, 63),
        ("lip.B.L.001", "head"): at(55, 65),
        ("lip.T.L.001", "tail"): at(54),
        ("lip.B.L.001", "tail"): at(54),
        ("jaw.L", "head"): at(16),
        ("jaw.L.001", "head"): at(13),
        ("chin.L", "head"): at(10),
    }
    return joints


def _middle(shape: FaceShape) -> dict[Joint, FloatArray]:
    """Return the joints of the middle, which lie between both sides."""

    def at(*numbers: int) -> FloatArray:
        return np.asarray(shape.landmarks[from_ibug(numbers)].mean(axis=0))

    lips = {("lip.T", "head"): at(51, 62), ("lip.B", "head"): at(57, 66)}
    return {
        **{(f"{lip}.{side}", end): place for (lip, end), place in lips.items() for side in "LR"},
        ("nose", "head"): at(27),
        ("nose.001", "head"): at(29),
        ("nose.002", "head"): at(30),
        ("nose.004", "head"): at(33),
        ("nose.004", "tail"): _mix(at(33), at(33, 51), 0.6),
        ("jaw", "head"): shape.jaw_pivot,
        ("jaw", "tail"): at(8),
        ("chin", "tail"): _mix(at(8), at(57), 0.35),
        ("chin.001", "tail"): _mix(at(8), at(57), 0.75),
    }


def _mix(a: FloatArray, b: FloatArray, share: float) -> FloatArray:
    return np.asarray((1.0 - share) * a + share * b)


def _between(points: list[FloatArray], place: float) -> FloatArray:
    """Lagrange's polynomial through points at 0, 1, 2 and so on."""
    total = np.zeros(3)
    for i, point in enumerate(points):
        others = [(place - j) / (i - j) for j in range(len(points)) if j != i]
        total += np.prod(others) * point
    return total
