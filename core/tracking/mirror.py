"""The other side of the mirror: what tracking would have given for the picture flipped left to right.

Performers who watch themselves expect a mirror: who lifts the brow on the left of the screen wants the avatar's on the
left to rise. Flipping what was tracked costs nothing and leaves the picture itself, its sound and its file alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..landmarks import MIRROR
from .result import TrackResult

_POSE = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
_GAZE = np.array([1.0, -1.0])
_SHAPE = np.array([-1.0, 1.0, 1.0])


def mirror_result(result: TrackResult, width: float, mode_signs: FloatArray | None = None) -> TrackResult:
    """`result` as of the picture of `width` pixels flipped left to right; done twice, it is `result` again.

    Parameters
    ----------
    width : float
        Of the image, pixels. Pixel centres have whole coordinates, so x becomes `width - 1 - x`.
    mode_signs : (K,), optional
        `PointDistributionModel.mirror_signs` of the tracker's model. Without them the shape parameters, whose meaning
        only the model knows, become NaN; everything else is exact in any case.
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
    )


def _flipped(points: FloatArray, width: float) -> FloatArray:
    """(N, 2) image points with x turned round."""
    return np.stack([width - 1.0 - points[:, 0], points[:, 1]], axis=1)
