"""Mirroring of results: what tracking would have found in the image flipped left to right.

Performers who watch themselves expect a mirror: if they raise the brow on the left of the screen, the avatar's brow on
the left should rise. Mirroring results costs nothing, and the video stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..face.actions import ACTION_MIRROR
from ..face.coefficient_names import COEFFICIENT_MIRROR
from ..face.landmarks import MIRROR
from ..numeric.arrays import FloatArray
from .result import TrackResult

_POSE = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
_GAZE = np.array([1.0, -1.0])
_SHAPE = np.array([-1.0, 1.0, 1.0])


def mirror_result(result: TrackResult, width: float, mode_signs: FloatArray | None = None) -> TrackResult:
    """Mirror a result left to right. Mirroring twice gives `result` again.

    Parameters
    ----------
    result : TrackResult
        The result to mirror.
    width : float
        Width of the image in pixels. Pixel centres have integer coordinates, so x becomes ``width - 1 - x``.
    mode_signs : (K,) float64, optional
        `PointDistributionModel.mirror_signs` of the model. Without them the shape parameters become NaN; everything
        else is exact in any case.

    Returns
    -------
    TrackResult
        What tracking would have found in the mirrored image.
    """
    signs = np.full(result.shape_params.shape, np.nan) if mode_signs is None else mode_signs
    landmarks, pupils = _flipped(result.landmarks, width)[MIRROR], _flipped(result.pupils, width)[::-1]
    pose = result.pose * _POSE
    pose[4] += width - 1.0
    return replace(
        result,
        landmarks=landmarks,
        pose=pose,
        shape_params=result.shape_params * signs,
        shape=(result.shape * _SHAPE)[MIRROR],
        landmark_confidence=result.landmark_confidence[MIRROR],
        pupils=pupils,
        gaze=result.gaze * _GAZE,
        actions=result.actions[ACTION_MIRROR],
        coefficients=result.coefficients[COEFFICIENT_MIRROR],
    )


def _flipped(points: FloatArray, width: float) -> FloatArray:
    """Mirror the x of image points (N, 2)."""
    return np.stack([width - 1.0 - points[:, 0], points[:, 1]], axis=1)
