"""Apertures of eyes and mouth, as used by tracking, retargeting and benchmarks (method.md, section 3.9).

An aperture is measured in the (x, y) plane, perpendicular to the line through the corners, so that it does not depend
on roll. It is signed, so that noise around shut lids has the mean 0.
"""

from __future__ import annotations

import numpy as np

from ..numeric.arrays import FloatArray, IntArray
from .landmarks import EYE_CORNERS, LOWER_LIDS, LOWER_LIPS, MOUTH_CORNERS, UPPER_LIDS, UPPER_LIPS

_EYE_ENDS = EYE_CORNERS[[0, 0, 2, 2]], EYE_CORNERS[[1, 1, 3, 3]]
_MOUTH_ENDS = MOUTH_CORNERS[:1], MOUTH_CORNERS[1:]
"""Corners of the slit of each pair of landmarks, at the viewer's left and right."""


def lid_gaps(points: FloatArray) -> FloatArray:
    """Signed gaps between facing landmarks of the lids, two of the right eye and two of the left.

    Parameters
    ----------
    points : (..., 66, 2) or (..., 66, 3) array
        Image or head frame; depth is ignored.

    Returns
    -------
    (..., 4) float64
        Gaps in the unit of the points (equation 3.7).
    """
    return _across(_between(points, *_EYE_ENDS), _between(points, UPPER_LIDS, LOWER_LIDS))


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
