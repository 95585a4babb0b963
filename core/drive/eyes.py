"""How an avatar's eyes turn within its head: as the performer's do, or, where that is not known, to the viewer."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..rotation import euler_to_matrix, matrix_to_euler

_LIMIT = np.radians((7.0, 22.0))
"""Pitch and yaw: up and down much less, as the lids, which follow the performer's, would hide the iris."""


class EyeDriver:
    """Turns the eyes of one avatar by those of one performer.

    Shut eyes tell no gaze: until they open again, the avatar's stay where they were last, unseen behind its lids.

    Parameters
    ----------
    straight : (2,)
        The performer's usual gaze, `Neutral.gaze`: the avatar looks straight out of its face then. NaN where a take
        tells no gaze; the eyes then stay on the viewer.
    """

    def __init__(self, straight: FloatArray) -> None:
        self._straight = np.asarray(straight, dtype=np.float64)
        self._last = np.zeros(2)

    def rotation(self, gaze: FloatArray, head: FloatArray) -> FloatArray:
        """(3, 3) rotation of both eyeballs within the head.

        Parameters
        ----------
        gaze : (2,)
            `TrackResult.gaze`.
        head : (3, 3)
            How the avatar's head is turned; eyes that stay on the viewer turn against it.
        """
        if not np.isfinite(self._straight).all():
            return gaze_at_viewer(head)
        if np.isfinite(gaze).all():
            self._last = gaze - self._straight
        return _turned(self._last)


def gaze_at_viewer(head: FloatArray) -> FloatArray:
    """Rotation of the eyes within a head turned by `head` (3, 3) that keeps them on the viewer, as far as eyes turn.

    People mostly look at the screen that they perform to, and an avatar whose eyes are fixed in its skull looks dead.
    """
    pitch, yaw, _ = matrix_to_euler(head.T)
    return _turned(np.array([pitch, yaw]))


def _turned(angles: FloatArray) -> FloatArray:
    pitch, yaw = (float(angle) for angle in np.clip(angles, -_LIMIT, _LIMIT))
    return euler_to_matrix(pitch, yaw, 0.0)
