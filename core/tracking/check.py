"""Learnt decision whether there is a face where a fit ended (method.md, section 3.6)."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from ..numeric.arrays import FloatArray

N_FEATURES = 6


@dataclass(frozen=True)
class FaceCheck:
    """Logistic regression over a few features of a fit.

    Attributes
    ----------
    weights : (6,) float64
        Weights of the features: 1; the log odds of the face network; and, for the maps of the face and those of the
        parts, the mean certainty and the mean distance between a map's mean and the fitted landmark.
    """

    weights: FloatArray

    def confidence(self, features: FloatArray) -> float:
        """Return the confidence, 0 to 1, for features (6,); 0.5 means that face and no face are equally likely."""
        return 1.0 / (1.0 + exp(-float(np.clip(features @ self.weights, -30.0, 30.0))))
