"""Where a performer looks and faces most of the time (method.md, section 4.1)."""

from __future__ import annotations

import numpy as np

from ..face.rotation import euler_to_matrix, matrix_to_euler
from ..numeric.arrays import FloatArray
from .take import Take

_FIXATION = 0.07
"""Standard deviation of measured gazes at one place, in radians."""
_ASKEW = 0.18
"""Standard deviation and largest value of the tracker's bias for a person, in radians."""
_SHIFTS = 20
"""Steps of mean shift towards the most frequent gaze."""
_MAX_GAZES = 1000
"""Largest number of gazes that are compared, evenly spaced."""


def facing(take: Take) -> FloatArray:
    """Return the rotation (3, 3) that the tracker measures when the performer's head faces the camera.

    It has only a pitch. The pitch of a face depends on its unknown profile, so it may be off by ten degrees. The eyes
    show it: they are usually straight in the head, so if they are turned against its usual pitch, it is that of a head
    facing the camera.
    """
    apart, _ = _frequent_gaze(take, np.eye(3))
    if np.isnan(apart[0]):
        return np.eye(3)
    usual = float(np.median(take.pose[take.found, 1]))
    pitch = np.clip(usual - apart[0], min(usual, 0.0), max(usual, 0.0))
    return euler_to_matrix(float(np.clip(pitch, -_ASKEW, _ASKEW)), 0.0, 0.0)


def usual_gaze(take: Take, rotation: FloatArray) -> FloatArray:
    """Return the gaze at which the avatar looks straight ahead, `(pitch, yaw)` in radians; NaN if no gaze is known.

    It is that at the camera, unless the performer usually looks too far away from it: then it has the usual pitch in
    the head, which people turn to what they look at, and no yaw. `rotation` (3, 3) is the one of the performer's head
    that does not turn the avatar's.
    """
    apart, at_camera = _frequent_gaze(take, rotation)
    ahead = np.asarray(matrix_to_euler(rotation)[:2])
    beside = np.hypot(*(apart + ahead)) / _ASKEW - 1.0
    camera = np.clip(apart, -ahead - _ASKEW, -ahead + _ASKEW)
    # Of 108 people who look at the camera, the pitch is measured 5 +- 4 degrees too high, the yaw 0 +- 1.4 aside.
    elsewhere = np.array([np.clip(apart[0] + at_camera[0], -_ASKEW, _ASKEW), 0.0])
    return np.asarray(camera + np.clip(beside, 0.0, 1.0) * (elsewhere - camera))


def _frequent_gaze(take: Take, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Most frequent gaze (2,), relative to that at the camera, and the latter (2,) at the usual pose; NaN if unknown.

    Performers look at the camera, or at the screen next to it, for longer than anywhere else, but often for less than
    half of the time, and not with an upright head. So the peak is found of the density of gazes relative to that at the
    camera; of several peaks, one that is not far from it is more probable.
    """
    known = np.flatnonzero(take.found & np.isfinite(take.gaze).all(axis=1))
    if not len(known):
        return np.full(2, np.nan), np.full(2, np.nan)
    known = known[:: 1 + len(known) // _MAX_GAZES]
    poses = take.pose[known, 1:4]
    *at_camera, usual = (_gaze_at_camera(pose, rotation) for pose in (*poses, np.median(poses, axis=0)))
    apart = take.gaze[known].astype(np.float64) - at_camera
    ahead = np.asarray(matrix_to_euler(rotation)[:2])
    found = apart[np.argmax(_near(apart[:, None], apart, _FIXATION).sum(axis=1) * _near(apart, -ahead, _ASKEW))]
    for _ in range(_SHIFTS):
        weights = _near(found, apart, _FIXATION)
        found = weights @ apart / weights.sum()
    return np.asarray(found), usual


def _gaze_at_camera(pose: FloatArray, rotation: FloatArray) -> FloatArray:
    """Gaze (2,) at the camera of a head with the angles `pose` (3,), for which `rotation` is straight ahead."""
    return np.asarray(matrix_to_euler(rotation @ euler_to_matrix(*pose).T)[:2])


def _near(one: FloatArray, other: FloatArray, extent: float) -> FloatArray:
    """Gaussian kernel (...) of two gazes (..., 2)."""
    return np.asarray(np.exp(-0.5 * ((one - other) ** 2).sum(axis=-1) / extent**2))
