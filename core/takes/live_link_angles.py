"""The nine angles of Live Link Face, in its packets and its tables alike (streams.md).

Those of the head and those of the eyes have opposite directions. The eyes do not turn about their line of sight; their
roll is due to the order of the angles.
"""

from __future__ import annotations

from math import asin, atan2, cos, sin

import numpy as np

from ..face.rotation import from_face_axes, to_face_axes
from ..numeric.arrays import FloatArray

HEAD = ("HeadYaw", "HeadPitch", "HeadRoll")
EYES = tuple(f"{side}Eye{axis}" for side in ("Left", "Right") for axis in ("Yaw", "Pitch", "Roll"))
"""Names of the nine angles in Live Link Face's tables, in the order of its packets."""


def head_rotation(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Convert the angles of the head.

    Parameters
    ----------
    yaw, pitch, roll : float
        Angles in radians: to the performer's left, up, and anticlockwise as the viewer sees it.

    Returns
    -------
    (3,) float64
        Pitch, yaw and roll in radians, as in `TrackResult`.
    """
    return from_face_axes(-pitch, yaw, roll)


def head_angles(rotation: FloatArray) -> tuple[float, float, float]:
    """Return the angles (yaw, pitch, roll) in radians that `head_rotation` converts to `rotation`, (3,)."""
    x, y, z = to_face_axes(rotation)
    return y, -x, z


def eye_directions(angles: FloatArray) -> FloatArray | None:
    """Convert the angles of the eyes.

    Parameters
    ----------
    angles : (6,) float64
        Angles in radians, in the order of `EYES`: yaw to the performer's right, pitch down.

    Returns
    -------
    (2, 2) float64 or None
        `(pitch, yaw)` of the right and the left eye in radians, as for the gaze in `TrackResult`; None if all angles
        are 0, as many programs leave them.
    """
    if not np.any(angles):
        return None
    eyes = []
    for yaw, pitch, _ in (angles[3:], angles[:3]):
        across, ahead = sin(yaw), cos(pitch) * cos(yaw)
        eyes.append((asin(sin(pitch) * cos(yaw)), atan2(across, ahead)))
    return np.array(eyes)


def eye_angles(eyes: FloatArray) -> tuple[float, ...]:
    """Return the six angles in radians that `eye_directions` converts to `eyes`, (2, 2)."""
    angles: list[float] = []
    for pitch, yaw in eyes[::-1].tolist():
        down, across = atan2(sin(pitch), cos(yaw) * cos(pitch)), asin(sin(yaw) * cos(pitch))
        angles += [across, down, atan2(sin(down) * sin(across), cos(down))]
    return tuple(angles)
