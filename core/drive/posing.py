"""Rotations of an avatar's head, eyes and jaw: their strength and limits, gaze, and the motion of the jaw."""

from __future__ import annotations

from collections import deque
from math import isnan, nan, pi

import numpy as np

from ..face.landmarks import CHIN, LOWER_LIPS, outer_eye_distance
from ..face.rotation import euler_to_matrix, fit_rotation, limit_rotation, matrix_to_euler
from ..numeric.arrays import FloatArray

_CHIN_ERROR = 0.01
"""Error of the motion of the chin, whose outline is faint, in outer-eye distances."""
_CHIN_ERROR_SHARE = 0.3
"""Further error of that motion, relative to it."""
_LIP_ALONE = 0.03
"""Motion of the lower lip by itself, in outer-eye distances."""
_MAX_FACTOR = 2.0
"""Largest factor by which the jaw is opened further than the chin suggests."""


_PARALLEL = np.radians(8.0)
"""Vergence relative to rest, in radians, up to which eyes count as parallel."""
_CROSSED = np.radians(40.0)
"""Largest vergence beyond that, in radians."""
_LASTING = 5
"""Number of frames for which eyes have to be crossed, as a misplaced pupil comes and goes."""
_AT_VIEWER = np.radians((7.0, 22.0))
"""Limits of pitch and yaw in radians of eyes that stay on the viewer. Pitch is small, as no lids follow it, which would
hide the iris."""
_ASIDE = np.radians(22.0)
"""Yaw in radians at which the travel of an iris is judged."""
_TRAVEL = 0.5
"""Distance that an iris may move between straight ahead and that yaw, relative to half the width of its eye. It is 0.3
for the built-in head, and 0.4 to 0.5 for realistic characters."""


class EyeDriver:
    """Rotates the eyes of an avatar by the gaze of a performer.

    Shut eyes have no gaze; the avatar's eyes then keep their last direction behind the lids. `straight` (2,) is the
    performer's usual gaze, `Neutral.gaze`, at which the avatar looks straight ahead; if it is NaN, as a take has no
    gaze, the eyes stay on the viewer. `parallel` is the vergence at rest, `Neutral.vergence`; if it is NaN, the eyes
    stay parallel.
    """

    def __init__(self, straight: FloatArray, parallel: float = nan) -> None:
        self._straight = np.asarray(straight, dtype=np.float64)
        self._parallel = parallel
        self._last = np.zeros(2)
        self._crossed: deque[float] = deque([0.0] * _LASTING, _LASTING)

    def follow(self, earlier: EyeDriver) -> None:
        """Continue from another driver of the same eyes: shut eyes keep their direction, crossed eyes stay crossed."""
        self._last = earlier._last + np.nan_to_num(earlier._straight - self._straight)
        self._crossed = earlier._crossed.copy()

    def rotations(self, gaze: FloatArray, vergence: float, head: FloatArray) -> FloatArray:
        """Return the rotations (2, 3, 3) of the right and left eyeball for gaze and vergence of a `TrackResult`.

        They are relative to the avatar's head. Eyes that stay on the viewer compensate its rotation, `head` (3, 3).
        """
        if not np.isfinite(self._straight).all():
            return np.tile(gaze_at_viewer(head), (2, 1, 1))
        if np.isfinite(gaze).all():
            # Relative to the usual gaze, as the performer looks at the screen, and not into the camera.
            self._last = gaze - self._straight
        if np.isfinite(vergence - self._parallel):
            crossed = vergence - self._parallel
            self._crossed.append(float(np.sign(crossed) * np.clip(abs(crossed) - _PARALLEL, 0.0, _CROSSED)))
        # Eyes are crossed by what all of the last frames agree on: the least of positive values, or of negative ones.
        least, most = min(self._crossed), max(self._crossed)
        aside = np.array([0.0, 0.5 * (max(least, 0.0) + min(most, 0.0))])
        return np.stack([_rotation(self._last - aside), _rotation(self._last + aside)])


def measured_eyes(gaze: FloatArray, vergence: float) -> FloatArray:
    """Return the rotations (2, 3, 3) of the right and left eyeball for a measured gaze and vergence, without delay.

    `(pitch, yaw)` are from straight ahead, the vergence is relative to rest, all in radians; NaN counts as 0.
    """
    aside = np.array([0.0, 0.5 * float(np.nan_to_num(vergence))])
    return np.stack([_rotation(np.nan_to_num(gaze) - aside), _rotation(np.nan_to_num(gaze) + aside)])


def eye_strength(pivot: FloatArray, corners: FloatArray) -> float:
    """Return the factor, at most 1, of the rotations of an eye that keeps its iris between the lids.

    A drawn eye is flat, and turns about a point far behind it, so that angles of a real eye, for which it is 1, would
    move its iris out of view. `pivot` (3,), about which the eye turns, and its `corners` (2, 3) are in one frame and
    unit.
    """
    half_width = 0.5 * float(np.linalg.norm(corners[1] - corners[0]))
    # A point at distance d from the pivot moves by d sin(yaw).
    moved = float(np.linalg.norm(corners.mean(axis=0) - pivot)) * float(np.sin(_ASIDE))
    return min(1.0, _TRAVEL * half_width / moved) if moved > 0.0 else 1.0


def gaze_at_viewer(head: FloatArray) -> FloatArray:
    """Return the rotation, within limits, that keeps eyes on the viewer for that of a head; fixed eyes look dead."""
    return _rotation(np.clip(matrix_to_euler(head.T)[:2], -_AT_VIEWER, _AT_VIEWER))


def _rotation(gaze: FloatArray) -> FloatArray:
    """Rotation (3, 3) of an eye by `(pitch, yaw)`."""
    return euler_to_matrix(float(gaze[0]), float(gaze[1]), 0.0)


class Jaw:
    """Fits the rotation of a jaw about `hinge`, given the landmarks (66, 3) at rest: head frame, unit of the mesh.

    `bite` is the angle in radians by which lower teeth rise from rest until they meet the upper ones.
    """

    def __init__(self, landmarks: FloatArray, hinge: FloatArray, bite: float = 0.0) -> None:
        self._bite = bite
        self._chin, self._lip = landmarks[CHIN] - hinge, landmarks[LOWER_LIPS].mean(axis=0) - hinge
        self._unit = outer_eye_distance(landmarks)

    def rotation(self, displacements: FloatArray, teeth: float = nan) -> FloatArray:
        """Return the rotation about the hinge that fits the displacements of the chin, for those of all landmarks (66,
        3), or that shuts the `teeth`, as in `TrackResult`.
        """
        opened, shut = self._opened(displacements), 0.0 if isnan(teeth) else teeth
        if shut <= 0.0:
            return opened
        return euler_to_matrix(-shut * self._bite, 0.0, 0.0) @ limit_rotation(opened, 1.0 - shut, pi)

    def _opened(self, displacements: FloatArray) -> FloatArray:
        """Return the rotation that fits the displacements of the chin.

        It is enlarged if the lower lip is further down than that would take it (equation 4.5). Displacements are in the
        head frame and the unit of the mesh.
        """
        moved = displacements[CHIN]
        rotation = fit_rotation(self._chin, self._chin + moved)
        taken = rotation @ self._lip - self._lip
        length = float(np.linalg.norm(taken))
        if taken[1] <= 1e-6 * self._unit:
            return rotation
        # The factor that agrees best with both, each in units of its error (equation 4.5).
        chin = float(np.linalg.norm(moved.sum(axis=0))) / (len(moved) * self._unit)
        trust = (chin / (_CHIN_ERROR + _CHIN_ERROR_SHARE * chin)) ** 2
        lip = float(displacements[LOWER_LIPS].sum(axis=0) @ taken) / (len(LOWER_LIPS) * length)
        once, squared = lip * length / (self._unit * _LIP_ALONE) ** 2, (length / (self._unit * _LIP_ALONE)) ** 2
        factor = (trust + once) / (trust + squared)
        return limit_rotation(rotation, min(max(factor, 1.0), _MAX_FACTOR), pi)
