"""From ARKit's 52 coefficients to tracking results: the built-in head shows them, and its landmarks are measured.

In this way streams of phones and VTuber programs, and tables of coefficients, drive any head as a camera does.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..face.coefficient_names import FITTED, N_COEFFICIENTS
from ..face.landmarks import outer_eye_distance
from ..face.rotation import euler_to_matrix
from ..heads.built_in import load_head
from ..heads.looks import LOOKS, gaze_of, gaze_of_eyes
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .from_animation import REST_POSITION, pose_of
from .neutral import Neutral


class CoefficientFace:
    """Shows coefficients on the built-in head.

    Attributes
    ----------
    neutral : Neutral
        The neutral face of all results, which is that of the built-in head.
    """

    def __init__(self) -> None:
        head = load_head()
        rest = head.vertices[head.landmarks].astype(np.float64)
        self.unit = outer_eye_distance(rest)
        self._rest = (rest - rest.mean(axis=0)) / self.unit
        self._units = head.units[FITTED][:, head.landmarks].astype(np.float64) / self.unit
        shut = np.zeros(N_COEFFICIENTS)
        self.neutral = replace(_at_rest(self._rest), gaze=gaze_of(shut[LOOKS])[0], vergence=0.0)

    def result(
        self,
        values: FloatArray,
        rotation: FloatArray,
        moved: FloatArray | None = None,
        eyes: FloatArray | None = None,
    ) -> TrackResult:
        """Return the result of an ideal tracker.

        Parameters
        ----------
        values : (52,) float64
            Coefficients in the order of `COEFFICIENTS`; clipped to 0 to 1.
        rotation : (3,) float64
            Pitch, yaw and roll of the head in radians, as in `TrackResult`.
        moved : (3,) float64, optional
            Translation of the head from rest: head frame, metres.
        eyes : (2, 2) float64, optional
            `(pitch, yaw)` of the right and the left eye in radians, as for the gaze in `TrackResult`; by default they
            follow from the coefficients.

        Returns
        -------
        TrackResult
            The result, with the coefficients and the pose-free shape that they produce.
        """
        pose = pose_of(euler_to_matrix(*rotation), np.zeros(3) if moved is None else np.asarray(moved) / self.unit)
        return self.posed(np.clip(values, 0.0, 1.0), pose, eyes)

    def posed(self, values: FloatArray, pose: FloatArray, eyes: FloatArray | None = None) -> TrackResult:
        """Return the result of an ideal tracker for a known pose.

        Parameters
        ----------
        values : (52,) float64
            Coefficients in the order of `COEFFICIENTS`, from 0 to 1.
        pose : (6,) float64
            As in `TrackResult`.
        eyes : (2, 2) float64, optional
            As for `result`.

        Returns
        -------
        TrackResult
            As for `result`.
        """
        shape = self._rest + np.tensordot(values[FITTED], self._units, 1)
        gaze, vergence = gaze_of(values[LOOKS]) if eyes is None else gaze_of_eyes(eyes)
        return TrackResult.exact(shape, pose, gaze=gaze, vergence=vergence, coefficients=values)


@lru_cache(maxsize=1)
def coefficient_face() -> CoefficientFace:
    """Return the face that all streams and tables share."""
    return CoefficientFace()


def _at_rest(shape: FloatArray) -> Neutral:
    return Neutral(
        shape=shape, rotation=np.eye(3), position=REST_POSITION.copy(), start=0.0, end=0.0, shut=0.0, measured=True
    )
