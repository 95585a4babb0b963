"""Results between and beyond others, for live frames that are missing, and for faces that return to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..face.coefficient_names import N_COEFFICIENTS
from ..face.rotation import euler_to_matrix, matrix_to_euler
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .neutral import Neutral


def between(first: TrackResult, second: TrackResult, share: float) -> TrackResult:
    """Interpolate, or extrapolate, between two results with a face.

    Parameters
    ----------
    first, second : TrackResult
        Results of the same source, with a face.
    share : float
        Position between the two: 0 gives `first`, 1 gives `second`, and larger values continue the motion.

    Returns
    -------
    TrackResult
        The result, with confidence 0, as it was not tracked. Values that are unknown in either are unknown.
    """

    def mixed(name: str) -> FloatArray:
        a, b = getattr(first, name), getattr(second, name)
        return np.asarray(a + share * (b - a))

    pose, shape = mixed("pose"), mixed("shape")
    pose[0] = first.pose[0] * (second.pose[0] / first.pose[0]) ** share
    turns = second.pose[1:4] - first.pose[1:4]
    pose[1:4] = first.pose[1:4] + share * (np.mod(turns + np.pi, 2.0 * np.pi) - np.pi)
    return replace(
        second,
        pose=pose,
        shape=shape,
        landmarks=pose[0] * (shape @ euler_to_matrix(*pose[1:4]).T)[:, :2] + pose[4:],
        confidence=0.0,
        pupils=mixed("pupils"),
        gaze=mixed("gaze"),
        vergence=float(mixed("vergence")),
        actions=mixed("actions"),
        coefficients=np.clip(mixed("coefficients"), 0.0, 1.0),
    )


def at_rest(neutral: Neutral, like: TrackResult) -> TrackResult:
    """Return the result of a neutral face.

    Parameters
    ----------
    like : TrackResult
        A result with a face from the same source. If it has coefficients, those of the result are 0.

    Returns
    -------
    TrackResult
        The face at rest, looking straight ahead, at the performer's usual position.
    """
    stated = np.isfinite(like.coefficients).all()
    scale, x, y = neutral.position
    return replace(
        like,
        pose=np.array([scale, *matrix_to_euler(neutral.rotation), x, y]),
        shape=neutral.shape,
        gaze=neutral.gaze,
        vergence=neutral.vergence,
        actions=neutral.actions,
        coefficients=np.zeros(N_COEFFICIENTS) if stated else like.coefficients,
    )
