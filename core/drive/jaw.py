"""The rotation of the jaw, with lower teeth and tongue, from the motion of the skin (method.md, section 4.5)."""

from __future__ import annotations

from math import pi

import numpy as np

from ..face.landmarks import CHIN, LOWER_LIPS, outer_eye_distance
from ..face.rotation import fit_rotation
from ..numeric.arrays import FloatArray
from .posing import limit_rotation

_CHIN_ERROR = 0.01
"""Error of the motion of the chin, whose outline is faint, in outer-eye distances."""
_CHIN_ERROR_SHARE = 0.3
"""Further error of that motion, relative to it."""
_LIP_ALONE = 0.03
"""Motion of the lower lip by itself, in outer-eye distances."""
_MAX_FACTOR = 2.0
"""Largest factor by which the jaw is opened further than the chin suggests."""


class Jaw:
    """Fits the rotation of a head's jaw.

    Parameters
    ----------
    landmarks : (66, 3) float64
        Landmarks at rest: head frame, unit of the mesh.
    hinge : (3,) float64
        A point on the axis of the jaw.
    """

    def __init__(self, landmarks: FloatArray, hinge: FloatArray) -> None:
        self._chin, self._lip = landmarks[CHIN] - hinge, landmarks[LOWER_LIPS].mean(axis=0) - hinge
        self._unit = outer_eye_distance(landmarks)

    def rotation(self, displacements: FloatArray) -> FloatArray:
        """Find the rotation about the hinge.

        Parameters
        ----------
        displacements : (66, 3) float64
            Displacements of the landmarks: head frame, unit of the mesh.

        Returns
        -------
        (3, 3) float64
            The rotation that fits the chin, enlarged if the lower lip is further down than that would take it.
        """
        moved = displacements[CHIN]
        rotation = fit_rotation(self._chin, self._chin + moved)
        taken = rotation @ self._lip - self._lip
        length = float(np.linalg.norm(taken))
        if taken[1] <= 1e-6 * self._unit:
            return rotation
        # The factor that agrees best with both, each in units of its error (equation 4.5).
        chin = float(np.linalg.norm(moved.mean(axis=0))) / self._unit
        trust = (chin / (_CHIN_ERROR + _CHIN_ERROR_SHARE * chin)) ** 2
        lip = float(displacements[LOWER_LIPS].mean(axis=0) @ taken) / length
        once, squared = lip * length / (self._unit * _LIP_ALONE) ** 2, (length / (self._unit * _LIP_ALONE)) ** 2
        factor = (trust + once) / (trust + squared)
        return limit_rotation(rotation, min(max(factor, 1.0), _MAX_FACTOR), pi)
