"""Rotations in the head frame: Euler angles, fits between point sets, and interpolation."""

from __future__ import annotations

from math import cos, pi, sin

import cv2
import numpy as np

from ..numeric import linalg
from ..numeric.arrays import FloatArray


def euler_to_matrix(pitch: float, yaw: float, roll: float) -> FloatArray:
    """Return the rotation matrix of angles in radians, ``R = Rz(roll) Ry(yaw) Rx(pitch)``.

    Positive pitch looks down, positive yaw turns to the viewer's left.
    """
    cx, sx, cy, sy, cz, sz = cos(pitch), sin(pitch), cos(yaw), sin(yaw), cos(roll), sin(roll)
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def euler_to_matrices(angles: FloatArray) -> FloatArray:
    """Return the rotation matrices (N, 3, 3) of angles (N, 3) in radians, as `euler_to_matrix` does for one."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles).T, np.sin(angles).T
    rows = [
        *(cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        *(sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        *(-sy, cy * sx, cy * cx),
    ]
    return np.asarray(np.stack(rows, axis=-1).reshape(-1, 3, 3))


def matrix_to_euler(rotation: FloatArray) -> tuple[float, float, float]:
    """Return pitch, yaw and roll, |yaw| <= pi / 2, of a rotation, (3, 3); the inverse of `euler_to_matrix`."""
    yaw = np.arctan2(-rotation[2, 0], np.hypot(rotation[2, 1], rotation[2, 2]))
    pitch = np.arctan2(rotation[2, 1], rotation[2, 2])
    roll = np.arctan2(rotation[1, 0], rotation[0, 0])
    return float(pitch), float(yaw), float(roll)


def from_face_axes(x: float, y: float, z: float) -> FloatArray:
    """Convert radians about the axes of ARKit's face anchor: to the viewer's right, up, and towards the viewer.

    The head turns about z first, then x, then y. The result (3,) is pitch, yaw and roll, as for `euler_to_matrix`.
    """
    turn = euler_to_matrix(0.0, -y, 0.0) @ euler_to_matrix(x, 0.0, 0.0) @ euler_to_matrix(0.0, 0.0, -z)
    return np.array(matrix_to_euler(turn))


def to_face_axes(rotation: FloatArray) -> tuple[float, float, float]:
    """Return the angles (x, y, z) in radians that `from_face_axes` converts to `rotation`, (3,) pitch, yaw and roll."""
    turn = euler_to_matrix(*rotation)
    x = float(np.arctan2(-turn[1, 2], np.hypot(turn[1, 0], turn[1, 1])))
    return x, -float(np.arctan2(turn[0, 2], turn[2, 2])), -float(np.arctan2(turn[1, 0], turn[1, 1]))


def fit_rotation(source: FloatArray, target: FloatArray) -> FloatArray:
    """Fit a rotation R about the origin to points (N, 3): minimise ``sum_i |R source_i - target_i|^2``.

    Kabsch 1976; the sign of the determinant after Umeyama 1991.
    """
    # LAPACK itself: the checks of `linalg.svd` take three times as long as a matrix of this size.
    u, _, vt, _ = linalg.lapack.dgesdd(target.T @ source)
    sign = np.sign(cv2.determinant(u @ vt))
    return np.asarray(u * np.array([1.0, 1.0, sign]) @ vt)


def mix_rotations(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    """Interpolate rotations (N, 3) along the shortest path at constant speed; a share of 0 gives `first`, 1 `second`.

    Spherical linear interpolation of quaternions (Shoemake 1985). The result has |yaw| <= pi / 2.
    """
    rotations = linalg.part("spatial.transform").Rotation
    start, end = rotations.from_euler("xyz", first), rotations.from_euler("xyz", second)
    turned = rotations.from_rotvec(share[:, None] * (end * start.inv()).as_rotvec()) * start
    return np.array([matrix_to_euler(turn) for turn in turned.as_matrix()]).reshape(-1, 3)


def to_quaternion(turn: FloatArray) -> tuple[float, float, float, float]:
    """Convert a rotation matrix (3, 3) to a quaternion (x, y, z, w) with w at least 0."""
    x, y, z, w = linalg.part("spatial.transform").Rotation.from_matrix(turn).as_quat(canonical=True).tolist()
    return x, y, z, w


def limit_rotation(rotation: FloatArray, strength: float, limit: float) -> FloatArray:
    """Multiply the angle of a rotation (3, 3) by `strength`, then limit it to `limit` radians, about the same axis."""
    if strength == 1.0 and limit >= pi:
        return rotation
    vector = np.array(cv2.Rodrigues(rotation)[0], dtype=np.float64).ravel()
    return np.array(cv2.Rodrigues(limit_vector(vector, strength, limit))[0], dtype=np.float64)


def limit_vector(vector: FloatArray, strength: float, limit: float) -> FloatArray:
    """Multiply a vector (3,) by `strength`, then limit its length to `limit`."""
    scaled = strength * np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(scaled))
    return np.asarray(scaled * (limit / length)) if length > limit else scaled
