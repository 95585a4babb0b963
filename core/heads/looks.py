"""The eyes' direction as ARKit's eight coefficients of it, and back, by the eyes of the built-in head."""

from __future__ import annotations

from functools import lru_cache
from math import atan2, cos, tan

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..coefficient_names import COEFFICIENT_INDEX
from ..rotation import fit_rotation
from .built_in import load_head

_WAYS = ("In", "Out", "Up", "Down")
LOOKS: NDArray[np.intp] = np.array(
    [COEFFICIENT_INDEX[f"eyeLook{way}{side}"] for side in ("Left", "Right") for way in _WAYS]
)
"""(8,) columns of the coefficients of the eyes' direction."""


def looks_of(rotations: FloatArray) -> FloatArray:
    """Find the coefficients of the eyes' direction.

    Parameters
    ----------
    rotations : (N, 2, 3, 3) float64
        Of the right and left eyeball.

    Returns
    -------
    (N, 8) float64
        Those of `LOOKS`, 0 to 1, as shares of the angle that each unit has.
    """
    forward = -rotations[..., 2]
    turned = np.stack([np.arctan2(forward[..., axis], -forward[..., 2]) for axis in (0, 1)])
    columns = [np.clip(turned[axis][:, side] / reach, 0.0, 1.0) for side, axis, reach in _reaches()]
    return np.column_stack(columns)


def gaze_of(looks: FloatArray) -> tuple[FloatArray, float]:
    """Find the direction of the eyes that coefficients state.

    Parameters
    ----------
    looks : (8,) float64
        Those of `LOOKS`.

    Returns
    -------
    gaze : (2,) float64
        `(pitch, yaw)` as in `TrackResult`, radians. Up and down is the mean of both eyes.
    vergence : float
        As in `TrackResult`, radians.
    """
    angles = np.zeros((2, 2))
    for value, (side, axis, reach) in zip(looks.tolist(), _reaches(), strict=True):
        angles[side, axis] += value * reach
    right, left = (np.array([atan2(tan(down) * cos(across), 1.0), -across]) for across, down in angles.tolist())
    return 0.5 * (right + left), float(left[1] - right[1])


@lru_cache(maxsize=1)
def _reaches() -> tuple[tuple[int, int, float], ...]:
    """For each of `LOOKS`, 0 for the right eye and 1 for the left, the axis along which it looks, and its signed angle
    at coefficient 1.
    """
    head = load_head()
    reaches = []
    for column in LOOKS.tolist():
        name = head.unit_names[column]
        eye = next(part for part in head.parts if part.name == ("eye_left" if "Left" in name else "eye_right"))
        rest = (eye.vertices - eye.pivot).astype(np.float64)
        forward = -fit_rotation(rest, rest + eye.units[column])[:, 2]
        axis = 0 if "In" in name or "Out" in name else 1
        reaches.append((int("Left" in name), axis, float(np.arctan2(forward[axis], -forward[2]))))
    return tuple(reaches)
