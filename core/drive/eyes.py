"""Rotation of an avatar's eyes: by the performer's gaze or, if that is unknown, towards the viewer."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..rotation import euler_to_matrix, matrix_to_euler

_LIMIT = np.radians((7.0, 22.0))
"""Limits of pitch and yaw. Pitch is small, as the lids, which follow the performer's, would hide the iris."""


class EyeDriver:
    """Turns the eyes of an avatar by the gaze of a performer.

    Shut eyes have no gaze; the avatar's, behind its lids, then keep their last direction.

    Parameters
    ----------
    straight : (2,) array
        The performer's usual gaze, `Neutral.gaze`, at which the avatar looks straight ahead. NaN if a take has no gaze;
        the eyes then stay on the viewer.
    """

    def __init__(self, straight: FloatArray) -> None:
        self._straight = np.asarray(straight, dtype=np.float64)
        self._last = np.zeros(2)

    def rotation(self, gaze: FloatArray, head: FloatArray) -> FloatArray:
        """Rotation of both eyeballs within the head.

        Parameters
        ----------
        gaze : (2,) float64
            `TrackResult.gaze`.
        head : (3, 3) float64
            Rotation of the avatar's head, against which eyes turn that stay on the viewer.

        Returns
        -------
        (3, 3) float64
            The rotation, within the limits.
        """
        if not np.isfinite(self._straight).all():
            return gaze_at_viewer(head)
        if np.isfinite(gaze).all():
            self._last = gaze - self._straight
        return _rotation_within_limits(self._last)


def gaze_at_viewer(head: FloatArray) -> FloatArray:
    """Rotation of the eyes in a head with the rotation `head`, (3, 3), that keeps them on the viewer within the limits.

    People mostly look at the screen in front of which they perform, and fixed eyes look dead.
    """
    pitch, yaw, _ = matrix_to_euler(head.T)
    return _rotation_within_limits(np.array([pitch, yaw]))


def _rotation_within_limits(angles: FloatArray) -> FloatArray:
    pitch, yaw = (float(angle) for angle in np.clip(angles, -_LIMIT, _LIMIT))
    return euler_to_matrix(pitch, yaw, 0.0)
