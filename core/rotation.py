"""Rotations of the head frame (x right, y down, z away): angles, vectors and the fit between two point sets."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from .arrays import FloatArray


def euler_to_matrix(pitch: float, yaw: float, roll: float) -> FloatArray:
    """R = Rz(roll) Ry(yaw) Rx(pitch), (3, 3): head frame to image axes."""
    cx, sx, cy, sy, cz, sz = cos(pitch), sin(pitch), cos(yaw), sin(yaw), cos(roll), sin(roll)
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def matrix_to_euler(rotation: FloatArray) -> tuple[float, float, float]:
    """(pitch, yaw, roll) with |yaw| <= pi / 2, the inverse of `euler_to_matrix`."""
    yaw = np.arctan2(-rotation[2, 0], np.hypot(rotation[2, 1], rotation[2, 2]))
    pitch = np.arctan2(rotation[2, 1], rotation[2, 2])
    roll = np.arctan2(rotation[1, 0], rotation[0, 0])
    return float(pitch), float(yaw), float(roll)


def fit_rotation(source: FloatArray, target: FloatArray) -> FloatArray:
    """The rotation R, (3, 3), that minimises sum |R source_i - target_i|^2 over (N, 3) points about the origin.

    References
    ----------
    Kabsch, Acta Crystallographica A32, 1976; the sign of the determinant after Umeyama 1991.
    """
    u, _, vt = np.linalg.svd(target.T @ source)
    sign = np.sign(np.linalg.det(u @ vt))
    return np.asarray(u * np.array([1.0, 1.0, sign]) @ vt)


def mix_rotations(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    """Rotations between two sets, by the short way at an even turn (Shoemake's slerp, SIGGRAPH 1985).

    Parameters
    ----------
    first, second : (N, 3)
        `(pitch, yaw, roll)`, radians.
    share : (N,)
        0 gives `first`, 1 gives `second`.

    Returns
    -------
    (N, 3) angles, |yaw| <= pi / 2.
    """
    a, b = _quaternions(first), _quaternions(second)
    cosine = (a * b).sum(axis=1)
    b = np.where(cosine[:, None] < 0.0, -b, b)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    near = angle < 1e-6  # the sines' ratio is the plain share there
    sine = np.where(near, 1.0, np.sin(angle))
    of_a = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    of_b = np.where(near, share, np.sin(share * angle) / sine)
    w, x, y, z = (of_a[:, None] * a + of_b[:, None] * b).T
    size = w * w + x * x + y * y + z * z
    pitch = np.arctan2(2.0 * (w * x + y * z), size - 2.0 * (x * x + y * y))
    yaw = np.arcsin(np.clip(2.0 * (w * y - z * x) / size, -1.0, 1.0))
    roll = np.arctan2(2.0 * (w * z + x * y), size - 2.0 * (y * y + z * z))
    return np.stack([pitch, yaw, roll], axis=1)


def _quaternions(angles: FloatArray) -> FloatArray:
    """(N, 4) unit quaternions (w, x, y, z) of (N, 3) pitch, yaw, roll."""
    (cp, cy, cr), (sp, sy, sr) = np.cos(angles / 2.0).T, np.sin(angles / 2.0).T
    return np.stack(
        [
            cr * cy * cp + sr * sy * sp,
            cr * cy * sp - sr * sy * cp,
            cr * sy * cp + sr * cy * sp,
            sr * cy * cp - cr * sy * sp,
        ],
        axis=1,
    )
