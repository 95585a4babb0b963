"""Rotations and vectors within limits: how far an avatar's head and eyes follow the performer's."""

from __future__ import annotations

from math import pi

import cv2
import numpy as np

from ..arrays import FloatArray


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
