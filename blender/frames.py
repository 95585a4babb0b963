"""The one place where axes change: the head frame of `core` (x viewer's right, y down, z away) to Blender's and back.

A head in Blender stands upright along +Z and faces -Y, as in the front view (numpad 1): viewer's right is +X, down is
-Z, away is +Y. Both frames are right-handed and in metres, so that the change is a proper rotation.
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
    """(..., 3) points or displacements of the head frame as (x, z, -y), a copy of the same type."""
    points = np.asarray(points)
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def flat_in_blender(vertices: NDArray[np.float32]) -> NDArray[np.float32]:
    """(3 V,) what `foreach_set` takes, of (V, 3) C-contiguous vertices: twice a copy's time, where numpy takes five."""
    return cv2.transform(vertices.reshape(1, -1, 3), HEAD_TO_BLENDER).reshape(-1)


def from_blender(points: ArrayLike) -> FloatArray:
    """(..., 3) points or displacements of Blender's frame as (x, -z, y), a copy of the same type."""
    points = np.asarray(points)
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def rotation_to_blender(rotation: ArrayLike) -> FloatArray:
    """(..., 3, 3) rotation matrices that act on the head frame, as those that do the same in Blender's."""
    return np.asarray(HEAD_TO_BLENDER @ np.asarray(rotation) @ HEAD_TO_BLENDER.T)
