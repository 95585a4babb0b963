"""Strength and limits of rotations and vectors, for an avatar's head and eyes."""

from __future__ import annotations

from math import pi

import cv2
import numpy as np

from ..numeric.arrays import FloatArray


def limit_rotation(rotation: FloatArray, strength: float, limit: float) -> FloatArray:
    """Scale and limit the angle of a rotation.

    Parameters
    ----------
    rotation : (3, 3) float64
        The rotation.
    strength : float
        Factor of the angle.
    limit : float
        Largest angle in radians, after the factor.

    Returns
    -------
    (3, 3) float64
        The rotation about the same axis.
    """
    if strength == 1.0 and limit >= pi:
        return rotation
    vector = np.array(cv2.Rodrigues(rotation)[0], dtype=np.float64).ravel()
    return np.array(cv2.Rodrigues(limit_vector(vector, strength, limit))[0], dtype=np.float64)


def limit_vector(vector: FloatArray, strength: float, limit: float) -> FloatArray:
    """Scale a vector and limit its length.

    Parameters
    ----------
    vector : (3,) float64
        The vector.
    strength : float
        Factor of the length.
    limit : float
        Largest length, after the factor.

    Returns
    -------
    (3,) float64
        The scaled vector.
    """
    scaled = strength * np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(scaled))
    return np.asarray(scaled * (limit / length)) if length > limit else scaled
