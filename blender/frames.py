"""Conversion between the head frame of `core` (x to the viewer's right, y down, z away) and Blender's axes.

No other module converts axes. A head in Blender stands upright along +Z and faces -Y, as in the front view: the
viewer's right is +X, down is -Z, away is +Y. Both frames are right-handed, so that the conversion is a rotation.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.floating[Any]]

HEAD_TO_BLENDER: NDArray[np.float64] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(3, 3) rotation C with `to_blender(x) = C x`."""


def to_blender(points: ArrayLike) -> FloatArray:
    """Convert (..., 3) points or displacements from the head frame to Blender's: (x, z, -y), as a copy."""
    points = np.asarray(points)
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def flat_in_blender(vertices: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert (V, 3) C-contiguous vertices from the head frame to the (3 V,) array that `foreach_set` takes.

    OpenCV needs twice the time of a copy for this, and numpy five times.
    """
    return np.asarray(cv2.transform(vertices.reshape(1, -1, 3), HEAD_TO_BLENDER), dtype=np.float32).reshape(-1)


def from_blender(points: ArrayLike) -> FloatArray:
    """Convert (..., 3) points or displacements from Blender's frame to the head frame: (x, -z, y), as a copy."""
    points = np.asarray(points)
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def rotation_to_blender(rotation: ArrayLike) -> FloatArray:
    """Convert (..., 3, 3) rotation matrices from the head frame to Blender's."""
    return np.asarray(HEAD_TO_BLENDER @ np.asarray(rotation) @ HEAD_TO_BLENDER.T)
