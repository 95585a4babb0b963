"""How far eyes and mouth are open: one definition for the tracker's results, the retargeting and the measurements.

An aperture is measured in the (x, y) plane across the line through the two corners of the eye or the mouth, so that it
does not depend on the head's roll, and is signed, so that noise about shut lids has the mean 0.
"""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray
from .landmarks import MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, from_ibug

UPPER_LIDS = from_ibug((37, 38, 43, 44))
LOWER_LIDS = from_ibug((41, 40, 47, 46))
UPPER_LIPS = MOUTH_INNER_UPPER
LOWER_LIPS = MOUTH_INNER_LOWER[::-1]
"""Upper and lower landmarks that face each other across the eye slits (right eye first) and the mouth slit."""
_VIEWERS_LEFT_CORNERS = from_ibug((36, 36, 42, 42))
_VIEWERS_RIGHT_CORNERS = from_ibug((39, 39, 45, 45))
_MOUTH_CORNERS = from_ibug((48, 54))


def lid_gaps(points: FloatArray) -> FloatArray:
    """(..., 4) signed gap between facing lid landmarks, two of the right eye and two of the left.

    Parameters
    ----------
    points : (..., 66, 2) or (..., 66, 3)
        Image or head frame, x to the viewer's right and y down; a depth is not looked at. Gaps are in their unit.
    """
    along = points[..., _VIEWERS_RIGHT_CORNERS, :2] - points[..., _VIEWERS_LEFT_CORNERS, :2]
    return _across(along, points[..., LOWER_LIDS, :2] - points[..., UPPER_LIDS, :2])


def lip_gaps(points: FloatArray) -> FloatArray:
    """(..., 3) signed gap between facing landmarks of the inner lips, from the viewer's left; as `lid_gaps`."""
    along = points[..., _MOUTH_CORNERS[1:], :2] - points[..., _MOUTH_CORNERS[:1], :2]
    return _across(along, points[..., LOWER_LIPS, :2] - points[..., UPPER_LIPS, :2])


def eye_apertures(points: FloatArray) -> FloatArray:
    """(..., 2) aperture of the performer's right and left eye: the mean of each eye's two lid gaps."""
    gaps = lid_gaps(points)
    return np.asarray(gaps.reshape(*gaps.shape[:-1], 2, 2).mean(axis=-1))


def mouth_aperture(points: FloatArray) -> FloatArray:
    """(...) aperture of the mouth: the mean of the three gaps of the inner lips."""
    return np.asarray(lip_gaps(points).mean(axis=-1))


def _across(along: FloatArray, gap: FloatArray) -> FloatArray:
    """(...) component of `gap` (..., 2) along the normal of `along` (..., 2) that points down in an upright face."""
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-12)
    return np.asarray((along[..., 0] * gap[..., 1] - along[..., 1] * gap[..., 0]) / length)
