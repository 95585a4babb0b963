"""The 66 landmarks: iBUG-68 without the inner mouth corners 60 and 64, in iBUG order; apertures of eyes and mouth.

Constants are positions in the array of 66 points. The documentation and the literature use iBUG numbers, which
`from_ibug` converts. The two agree below 60.

An aperture is measured in the (x, y) plane, perpendicular to the line through the corners, so that it does not
depend on roll. It is signed, so that noise around shut lids has the mean 0.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DataError
from ..numeric.arrays import FloatArray, IntArray

N_LANDMARKS = 66


IBUG68_INDICES: NDArray[np.intp] = np.array([i for i in range(68) if i not in (60, 64)])
"""(66,) iBUG-68 numbers of the landmarks: ``points68[IBUG68_INDICES]`` are the 66 points."""


def from_ibug(numbers: Iterable[int]) -> NDArray[np.intp]:
    """Return the positions of iBUG-68 `numbers` in the array of 66 points; ValueError for 60, 64 and unknown ones."""
    position = {int(ibug): i for i, ibug in enumerate(IBUG68_INDICES)}
    numbers = [int(n) for n in numbers]
    if unknown := [n for n in numbers if n not in position]:
        raise DataError("not among the 66 landmarks: {unknown}", unknown=unknown)
    return np.array([position[n] for n in numbers], dtype=np.intp)


JAW = from_ibug(range(0, 17))
BROWS = from_ibug(range(17, 27))
NOSE = from_ibug(range(27, 36))
EYE_RIGHT = from_ibug(range(36, 42))
"""The performer's right eye, on the viewer's left: outer corner, two of the upper lid, inner corner, lower lid."""
EYE_LEFT = from_ibug(range(42, 48))
"""The performer's left eye: inner corner, two of the upper lid, outer corner, two of the lower lid."""
MOUTH_OUTER = from_ibug(range(48, 60))
MOUTH_INNER_UPPER = from_ibug(range(61, 64))
MOUTH_INNER_LOWER = from_ibug(range(65, 68))
LIPS = np.concatenate([MOUTH_OUTER, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
INNER = np.arange(17, N_LANDMARKS)
"""The 49 inner points (all but the jaw line), over which errors are reported."""
EYE_CORNERS = from_ibug((36, 39, 42, 45))
"""From the viewer's left to right: outer and inner corner of the right eye, inner and outer corner of the left eye."""
OUTER_EYE_CORNERS = EYE_CORNERS[[0, 3]]
"""The distance between them is the eye distance, the unit of the shape model and of reported errors."""
UPPER_LIDS, LOWER_LIDS = from_ibug((37, 38, 43, 44)), from_ibug((41, 40, 47, 46))
"""Landmarks that face each other across the eye slits, the performer's right eye first."""
MOUTH_CORNERS = from_ibug((48, 54))
"""The performer's right and left corner."""
UPPER_LIP, LOWER_LIP = from_ibug(range(49, 54)), from_ibug(range(59, 54, -1))
"""The lips' outer rims between the corners, from the viewer's left."""
UPPER_LIPS, LOWER_LIPS = MOUTH_INNER_UPPER, MOUTH_INNER_LOWER[::-1]
"""Landmarks of the inner rims that face each other across the mouth, from the viewer's left."""
CHIN = from_ibug(range(6, 11))
NOSE_ROOT = from_ibug((27, 28))


def outer_eye_distance(points: ArrayLike) -> float:
    """Distance between the outer corners of the eyes, in the unit of the landmarks `points`, (66, D)."""
    right, left = np.asarray(points, dtype=np.float64)[OUTER_EYE_CORNERS]
    return float(np.linalg.norm(right - left))


_MIRROR_IBUG = np.array(
    [*range(16, -1, -1), *range(26, 16, -1), 27, 28, 29, 30, 35, 34, 33, 32, 31]
    + [45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40]
    + [54, 53, 52, 51, 50, 49, 48, 59, 58, 57, 56, 55, 64, 63, 62, 61, 60, 67, 66, 65]
)
MIRROR: NDArray[np.intp] = from_ibug(_MIRROR_IBUG[IBUG68_INDICES])
"""(66,) mirror image of each landmark: ``points[MIRROR]`` relabels a face that was flipped left to right."""

_RIGHT_HALF = np.concatenate([JAW[:8], BROWS[:5], EYE_RIGHT])


def symmetry_plane(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the plane of symmetry of landmarks (66, 3): a point on it, and its unit normal to the performer's left.

    It passes through the mean landmark, normal to the mean direction between mirrored pairs.
    """
    to_left = (points[MIRROR[_RIGHT_HALF]] - points[_RIGHT_HALF]).sum(axis=0)
    return np.asarray(points.mean(axis=0)), np.asarray(to_left / np.linalg.norm(to_left))


EDGES: tuple[tuple[int, int], ...] = tuple(
    (int(a), int(b))
    for chain, closed in (
        (JAW, False),
        (BROWS[:5], False),
        (BROWS[5:], False),
        (NOSE[:4], False),
        (NOSE[4:], False),
        (EYE_RIGHT, True),
        (EYE_LEFT, True),
        (MOUTH_OUTER, True),
        (MOUTH_INNER_UPPER, False),
        (MOUTH_INNER_LOWER, False),
    )
    for a, b in zip(chain, [*chain[1:], chain[0]] if closed else chain[1:], strict=False)
)
"""Pairs of landmarks that are connected in drawings."""


_EYE_ENDS = EYE_CORNERS[[0, 0, 2, 2]], EYE_CORNERS[[1, 1, 3, 3]]
_MOUTH_ENDS = MOUTH_CORNERS[:1], MOUTH_CORNERS[1:]
"""Corners of the slit of each pair of landmarks, at the viewer's left and right."""


def lid_gaps(points: FloatArray) -> FloatArray:
    """Signed gaps (..., 4) between facing landmarks of the lids, first of the right eye, in the unit of the points.

    Equation 3.7, of points (..., 66, 2) or (..., 66, 3) in the image or head frame, of which depth is ignored.
    """
    return _across(_between(points, *_EYE_ENDS), _between(points, UPPER_LIDS, LOWER_LIDS))


def lid_normals(points: FloatArray) -> FloatArray:
    """Unit vectors (..., 4, 2) in x and y across the eye, along which `lid_gaps` are measured; of points as there."""
    along = _between(points, *_EYE_ENDS)
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-12)
    return np.stack([-along[..., 1] / length, along[..., 0] / length], axis=-1)


def lip_gaps(points: FloatArray) -> FloatArray:
    """Signed gaps between facing landmarks of the inner lips, (..., 3), from the viewer's left; see `lid_gaps`."""
    return _across(_between(points, *_MOUTH_ENDS), _between(points, UPPER_LIPS, LOWER_LIPS))


def eye_apertures(points: FloatArray) -> FloatArray:
    """Apertures of the performer's right and left eye, (..., 2): the mean of the two gaps of each eye."""
    gaps = lid_gaps(points)
    return np.asarray(0.5 * (gaps[..., ::2] + gaps[..., 1::2]))


def mouth_aperture(points: FloatArray) -> FloatArray:
    """Aperture of the mouth, (...): the mean of the three gaps of the inner lips."""
    return np.asarray(lip_gaps(points).mean(axis=-1))


def _between(points: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """Vectors from the landmarks `first` (n,) to the landmarks `second` (n,), (..., n, D)."""
    return np.asarray(points.take(second, axis=-2) - points.take(first, axis=-2))


def _across(along: FloatArray, gap: FloatArray) -> FloatArray:
    """Component of `gap` along the normal of `along` in x and y, (...); in an upright face the normal points down."""
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-12)
    return np.asarray((along[..., 0] * gap[..., 1] - along[..., 1] * gap[..., 0]) / length)
