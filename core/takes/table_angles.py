"""Rotations of the head and directions of the eyes: as the nine angles of Live Link Face (streams.md), and in tables of
coefficients (takes.md).

Those of the head and those of the eyes have opposite directions. The eyes do not turn about their line of sight;
their roll is due to the order of the angles.
"""

from __future__ import annotations

import re
from math import asin, atan2, cos, pi, sin

import numpy as np

from ..face.names import COEFFICIENT_INDEX
from ..face.rotation import from_face_axes, to_face_axes
from ..numeric.arrays import FloatArray

HEAD = ("HeadYaw", "HeadPitch", "HeadRoll")
AUTOMATIC, RADIANS, DEGREES = "automatic", "radians", "degrees"


EYES = tuple(f"{side}Eye{axis}" for side in ("Left", "Right") for axis in ("Yaw", "Pitch", "Roll"))
"""Names of the nine angles in Live Link Face's tables, in the order of its packets."""


def head_rotation(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Convert radians to the performer's left, up, and anticlockwise for the viewer to those of `TrackResult`."""
    return from_face_axes(-pitch, yaw, roll)


def head_angles(rotation: FloatArray) -> tuple[float, float, float]:
    """Return the angles (yaw, pitch, roll) in radians that `head_rotation` converts to `rotation`, (3,)."""
    x, y, z = to_face_axes(rotation)
    return y, -x, z


def eye_directions(angles: FloatArray) -> FloatArray | None:
    """Convert angles (6,) of `EYES` in radians, yaw to the performer's right and pitch down, to a gaze per eye.

    It is the `(pitch, yaw)` of the right and the left eye, (2, 2), as in `TrackResult`; None if all angles are 0, as
    many programs leave them.
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


_PART = re.compile(r"(head|lefteye|righteye)(?:rotation)?(yaw|pitch|roll)(d|deg|degrees?|r|rad|radians?)?")
"""Titles of the angles of the head and the eyes, and their unit, as letters in lower case."""
_ORDER = tuple(name.lower() for name in (*HEAD, *EYES))
_FURTHEST = np.radians([100.0, 80.0, 70.0])
"""Yaw, pitch and roll, in radians, beyond which no head turns while its face is tracked."""
_PER_COEFFICIENT = 4.6
"""Pitch of an eye per eyeLookDown above which it is in degrees: the geometric mean of 35 degrees, and that in radians,
which a phone's recording and table have."""
_LEAST_LOOK = 0.01
"""Smallest standard deviation of eyeLookDown - eyeLookUp at which that slope counts."""
_LEAST_CORRELATION = 0.7
"""Smallest correlation of that difference with the pitch at which the slope counts. It is .9997 in a phone's
recording."""
_DOWN, _UP = ([COEFFICIENT_INDEX[f"eyeLook{way}{side}"] for side in ("Left", "Right")] for way in ("Down", "Up"))


def angle_of(title: str) -> tuple[int, str] | None:
    """Return which of the nine angles a column has, and the unit that its title states or ""; None for others."""
    matched = _PART.fullmatch(re.sub(r"[\W_]", "", title.lower()))
    if matched is None:
        return None
    unit = {"d": DEGREES, "r": RADIANS}.get((matched[3] or " ")[0], "")
    return _ORDER.index(matched[1] + matched[2]), unit


def unit_of_angles(angles: FloatArray, coefficients: FloatArray) -> str:
    """Decide whether a table's angles (N, 9) of `HEAD` and `EYES`, 0 where missing, are "radians" or "degrees".

    The angles of the eyes decide, if they follow the coefficients (N, 52) in the same row; otherwise it is radians,
    unless the head would turn too far.
    """
    looks = (coefficients[:, _DOWN] - coefficients[:, _UP]).ravel()
    pitches = angles[:, [4, 7]].ravel()
    if looks.std() > _LEAST_LOOK and pitches.std() > 0.0:
        correlation = abs(float(np.corrcoef(looks, pitches)[0, 1]))
        if correlation > _LEAST_CORRELATION:
            return DEGREES if correlation * pitches.std() / looks.std() > _PER_COEFFICIENT else RADIANS
    return DEGREES if (np.abs(angles[:, :3]).max(axis=0) > _FURTHEST).any() else RADIANS


def poses_of(angles: FloatArray, unit: str) -> tuple[FloatArray, list[FloatArray | None]]:
    """Convert a table's angles (N, 9) of `HEAD` and `EYES` to rotations of the head and directions of the eyes.

    Rotations (N, 3) are in radians, as in `TrackResult`. The eyes of each row are as from `eye_directions`, but all
    None if no row has any.
    """
    radians = angles * (pi / 180.0 if unit == DEGREES else 1.0)
    rotations = np.array([head_rotation(*row) for row in radians[:, :3].tolist()])
    if not radians[:, 3:].any():
        return rotations, [None] * len(radians)
    straight = np.zeros((2, 2))
    found = [eye_directions(row) for row in radians[:, 3:]]
    return rotations, [straight if eyes is None else eyes for eyes in found]
