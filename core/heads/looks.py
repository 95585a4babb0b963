"""Conversion between the direction of the eyes and ARKit's eight coefficients for it, as on the built-in head."""

from __future__ import annotations

from functools import lru_cache
from math import atan2, cos, tan

import numpy as np
from numpy.typing import NDArray

from ..face.coefficient_names import COEFFICIENT_INDEX
from ..face.rotation import fit_rotation
from ..numeric.arrays import FloatArray
from .built_in import load_head

_DIRECTIONS = ("In", "Out", "Up", "Down")
LOOKS: NDArray[np.intp] = np.array(
    [COEFFICIENT_INDEX[f"eyeLook{direction}{side}"] for side in ("Left", "Right") for direction in _DIRECTIONS]
)
"""(8,) columns of the coefficients for the direction of the eyes."""
_PHONE_REACH = np.radians((35.2, 33.0))
"""Pitch and yaw of an eye in radians at which an iPhone states a coefficient of 1, from 560 of its packets."""


def looks_of(rotations: FloatArray) -> FloatArray:
    """Compute the coefficients for the direction of the eyes.

    Parameters
    ----------
    rotations : (N, 2, 3, 3) float64
        Rotations of the right and the left eyeball.

    Returns
    -------
    (N, 8) float64
        Coefficients in the order of `LOOKS`, 0 to 1: shares of the angle of each unit.
    """
    forward = -rotations[..., 2]
    turned = np.stack([np.arctan2(forward[..., axis], -forward[..., 2]) for axis in (0, 1)])
    columns = [np.clip(turned[axis][:, side] / reach, 0.0, 1.0) for side, axis, reach in _reaches()]
    return np.column_stack(columns)


def gaze_of(looks: FloatArray) -> tuple[FloatArray, float]:
    """Compute the direction of the eyes from their coefficients.

    Parameters
    ----------
    looks : (8,) float64
        Coefficients in the order of `LOOKS`.

    Returns
    -------
    gaze : (2,) float64
        `(pitch, yaw)` in radians, as in `TrackResult`. The pitch is the mean of both eyes.
    vergence : float
        As in `TrackResult`, in radians.
    """
    angles = np.zeros((2, 2))
    for value, (side, axis, reach) in zip(looks.tolist(), _reaches(), strict=True):
        angles[side, axis] += value * reach
    return gaze_of_eyes(np.array([[atan2(tan(down) * cos(across), 1.0), -across] for across, down in angles.tolist()]))


def gaze_of_eyes(eyes: FloatArray) -> tuple[FloatArray, float]:
    """Return gaze and vergence, as from `gaze_of`, of the `(pitch, yaw)` of the right and left eye, (2, 2)."""
    return eyes.mean(axis=0), float(eyes[1, 1] - eyes[0, 1])


def looks_of_eyes(eyes: FloatArray) -> FloatArray:
    """Compute the coefficients that a phone states for the directions of the eyes.

    Parameters
    ----------
    eyes : (2, 2) float64
        `(pitch, yaw)` of the right and the left eye in radians, as for the gaze in `TrackResult`.

    Returns
    -------
    (8,) float64
        Coefficients in the order of `LOOKS`, 0 to 1.
    """
    (right_down, right_in), (left_down, left_in) = (eyes * [[1.0, -1.0], [1.0, 1.0]] / _PHONE_REACH).tolist()
    ways = [left_in, -left_in, -left_down, left_down, right_in, -right_in, -right_down, right_down]
    return np.clip(ways, 0.0, 1.0)


def eyes_of_gaze(gaze: FloatArray, vergence: float) -> FloatArray:
    """Return the `(pitch, yaw)` of the right and left eye, (2, 2), that have this gaze and vergence in radians."""
    return gaze + np.array([[0.0, -0.5], [0.0, 0.5]]) * vergence


@lru_cache(maxsize=1)
def _reaches() -> tuple[tuple[int, int, float], ...]:
    """Return for each of `LOOKS` the eye (0 right, 1 left), the axis along which it looks, and the signed angle in
    radians at coefficient 1.
    """
    head = load_head()
    reaches = []
    for column in LOOKS.tolist():
        name = head.unit_names[column]
        eye = head.part("eye_left" if "Left" in name else "eye_right")
        rest = (eye.vertices - eye.pivot).astype(np.float64)
        forward = -fit_rotation(rest, rest + eye.units[column])[:, 2]
        axis = 0 if "In" in name or "Out" in name else 1
        reaches.append((int("Left" in name), axis, float(np.arctan2(forward[axis], -forward[2]))))
    return tuple(reaches)
