"""Lids of both eyes, which open and close together unless an eye winks (method.md, section 3.14)."""

from __future__ import annotations

import numpy as np

from ..face.landmarks import EYE_CORNERS, LOWER_LIDS, N_LANDMARKS, UPPER_LIDS
from ..face.rotation import euler_to_matrix
from ..numeric.arrays import FloatArray

_UNSURE = 0.015
"""Difference between the openings of both eyes, in eye distances, of which half is shown. Chosen on half A of the
strangers' clips for the correlation of lids with the other program's; from 0.01 to 0.02 it is about the same."""
_UNSURE_PIXELS = 0.5
"""What is added to it, squared, in pixels: lids of a small face are two pixels apart."""
_NARROWEST = 0.2
"""Least ratio of an eye's width in the image to its true one by which it counts."""
_OPENINGS = np.zeros((2, N_LANDMARKS))
"""Weights of heights whose sums are the openings of the right and the left eye."""
_RAISED = np.zeros((N_LANDMARKS, 2))
"""By how much landmarks are lowered for each eye to open by 1."""
for _eye in (0, 1):
    _pairs = slice(2 * _eye, 2 * _eye + 2)
    _OPENINGS[_eye, LOWER_LIDS[_pairs]], _OPENINGS[_eye, UPPER_LIDS[_pairs]] = 0.5, -0.5
    _RAISED[UPPER_LIDS[_pairs], _eye] = -1.0


def pair_lids(pose: FloatArray, shape: FloatArray) -> FloatArray:
    """Return a copy of `shape` whose upper lids are brought nearer to where both eyes are open alike.

    `pose` (6,) and `shape` (66, 3), in the head frame and outer-eye distances, are as in `TrackResult`. A small
    difference is taken for an error, and a large one for a wink, which stays. The eye that is seen better counts more.
    """
    scale, pitch, yaw, roll, *_ = pose.tolist()
    openings = _OPENINGS @ shape[:, 1]
    right, left = openings.tolist()
    corners = shape[EYE_CORNERS]
    across = corners[1::2] - corners[::2]
    away = across @ euler_to_matrix(pitch, yaw, roll)[2]
    # Squared widths of the eyes in the image, relative to the true ones.
    seen = [
        max(1.0 - depth * depth / length, _NARROWEST**2)
        for depth, length in zip(away.tolist(), (across * across).sum(axis=1).tolist(), strict=True)
    ]
    # Errors grow as an eye narrows; equation 3.12.
    unsure = (_UNSURE**2 + (_UNSURE_PIXELS / scale) ** 2) * 0.5 * (1.0 / seen[0] + 1.0 / seen[1])
    error = unsure / ((right - left) ** 2 + unsure)
    alike = (seen[0] * right + seen[1] * left) / (seen[0] + seen[1])
    out = shape.copy()
    out[:, 1] += _RAISED @ (error * (alike - openings))
    return out
