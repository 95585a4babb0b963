"""Fitting of a motion of vertices by shape keys that a mesh already has (docs/method.md, section 9.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..products import multiply
from .least_squares import bounded_least_squares

RIDGE = 1e-4
"""Ridge as a share of the mean square of a key. Similar keys then share motion, and undetermined ones stay at 0."""
_ROWS = 64
"""Number of frames processed at a time."""


@dataclass(frozen=True)
class KeyFit:
    """Weights of shape keys, and the errors of the fit.

    Attributes
    ----------
    weights : (N, K) float64
        Weights, within the bounds.
    worst_error, mean_error : float
        Largest and root mean square distance of the vertices from the motion, in its unit.
    """

    weights: FloatArray
    worst_error: float
    mean_error: float


def fit_keys(motion: FloatArray, keys: FloatArray, lower: FloatArray, upper: FloatArray) -> KeyFit:
    """Fit weights of shape keys to a motion, by least squares within bounds.

    Parameters
    ----------
    motion : (N, V, 3) array
        Displacements from rest.
    keys : (K, V, 3) array
        Displacements at weight 1.
    lower, upper : (K,) array
        Range of the weight of each key.

    Returns
    -------
    KeyFit
        Weights and errors.

    Notes
    -----
    Equation 9.1.
    """
    flat = np.ascontiguousarray(keys, dtype=np.float64).reshape(len(keys), -1)
    # Normal equations of equation 9.1, in which the motion enters only by its products with the keys.
    gram = flat @ flat.T
    gram[np.diag_indices(len(gram))] += RIDGE * max(float(np.trace(gram)) / max(len(gram), 1), 1e-30)
    products = np.concatenate(
        [motion[n : n + _ROWS].reshape(len(motion[n : n + _ROWS]), -1) @ flat.T for n in range(0, len(motion), _ROWS)]
    )
    weights = bounded_least_squares(gram, products, np.asarray(lower, float), np.asarray(upper, float))
    return KeyFit(weights, *mix_errors(motion, keys, weights))


def mix_errors(motion: FloatArray, keys: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Compute the errors of a mix of shape keys.

    Parameters
    ----------
    motion, keys : (N, V, 3), (K, V, 3) array
        As for `fit_keys`.
    weights : (N, K) array
        Weights of the keys.

    Returns
    -------
    float
        Largest distance of a vertex from the motion.
    float
        Root mean square distance.
    """
    flat = np.ascontiguousarray(keys, dtype=np.float32).reshape(len(keys), -1)
    worst, total = 0.0, 0.0
    for n in range(0, len(motion), _ROWS):
        part = motion[n : n + _ROWS]
        mixed = multiply(weights[n : n + _ROWS], flat)
        squared = np.square(mixed.reshape(part.shape) - part).sum(axis=2, dtype=np.float64)
        worst, total = max(worst, float(squared.max(initial=0.0))), total + float(squared.sum())
    return float(np.sqrt(worst)), float(np.sqrt(total / max(motion.shape[0] * motion.shape[1], 1)))
