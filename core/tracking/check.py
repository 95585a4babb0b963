"""Is there a face where the fit ended? A learnt answer, since the fit's own score is a weak one."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .patch_experts import ResponseMaps
from .start import gradient_features


def response_at(maps: ResponseMaps, landmarks: FloatArray) -> NDArray[np.float32]:
    """(N,) largest response within one pixel of each landmark (N, 2) of the reference frame."""
    side = maps.probability.shape[1]
    place = np.clip(np.round(landmarks).astype(np.intp) - maps.corner, 1, side - 2)
    rows = place[:, 1, None] + np.array([-1, -1, -1, 0, 0, 0, 1, 1, 1])
    columns = place[:, 0, None] + np.array([-1, 0, 1, -1, 0, 1, -1, 0, 1])
    best: NDArray[np.float32] = maps.probability[np.arange(len(place))[:, None], rows, columns].max(axis=1)
    return best


def check_features(grey: NDArray[np.uint8], pose: FloatArray, responses: NDArray[np.float32]) -> NDArray[np.float32]:
    """(66 + 1765,) what the check looks at: the experts' opinion and the gradients of the whole face."""
    return np.concatenate([responses, gradient_features(grey, pose)])


@dataclass(frozen=True)
class FaceCheck:
    """Logistic regression over `check_features`.

    Attributes
    ----------
    weights : (1831,) float64
    """

    weights: FloatArray

    def confidence(self, features: NDArray[np.float32]) -> float:
        """0 to 1; 0.5 is where a fit is as likely lost as not."""
        return 1.0 / (1.0 + exp(-float(np.clip(features @ self.weights, -30.0, 30.0))))
