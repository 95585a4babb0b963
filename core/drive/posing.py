"""How far an avatar's head and eyes follow the performer's: strength and limits."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import cv2
import numpy as np

from ..arrays import FloatArray


@dataclass(frozen=True)
class Posing:
    """What the pose of the head and of the eyes is multiplied by, and where it ends.

    Attributes
    ----------
    rotation, location, eyes : float
        Strength: 0 rests, 1 follows the performer.
    rotation_limit, eyes_limit : float
        Radians from rest, about whatever axis.
    location_limit : float
        From rest, in the avatar's outer-eye distances.
    """

    rotation: float = 1.0
    rotation_limit: float = pi
    location: float = 1.0
    location_limit: float = inf
    eyes: float = 1.0
    eyes_limit: float = pi


def limited_rotation(rotation: FloatArray, strength: float, limit: float) -> FloatArray:
    """`rotation` (3, 3) about its own axis by `strength` times its angle, at most `limit` radians."""
    if strength == 1.0 and limit >= pi:
        return rotation
    vector = np.array(cv2.Rodrigues(rotation)[0], dtype=np.float64).ravel()
    return np.array(cv2.Rodrigues(limited_vector(vector, strength, limit))[0], dtype=np.float64)


def limited_vector(vector: FloatArray, strength: float, limit: float) -> FloatArray:
    """`vector` times `strength`, shortened to `limit` where it is longer."""
    scaled = strength * np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(scaled))
    return np.asarray(scaled * (limit / length)) if length > limit else scaled
