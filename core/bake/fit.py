"""A vertex motion as weights of shape keys that a mesh has: a key called "jawOpen" rather than a third component."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .least_squares import bounded_least_squares

RIDGE = 1e-4
"""Of the mean square of a key: shares among keys that look alike, and leaves those at rest that nothing tells."""
_ROWS = 64


@dataclass(frozen=True)
class KeyFit:
    """Weights of keys, and how far they end from what they stand for.

    Attributes
    ----------
    weights : (N, K) float64
        Within the bounds.
    worst_error, mean_error : float
        Distance of the vertices from the motion, in its unit: the largest of all, and the root mean square.
    """

    weights: FloatArray
    worst_error: float
    mean_error: float


def fit_keys(motion: FloatArray, keys: FloatArray, lower: FloatArray, upper: FloatArray) -> KeyFit:
    """The weights within bounds whose mix of `keys` is next to `motion`, frame by frame, by least squares.

    Parameters
    ----------
    motion : (N, V, 3) array
        Displacements from rest.
    keys : (K, V, 3) array
        Displacements at weight 1.
    lower, upper : (K,) array
        Each key's range.
    """
    flat = np.ascontiguousarray(keys, dtype=np.float64).reshape(len(keys), -1)
    gram = flat @ flat.T
    gram[np.diag_indices(len(gram))] += RIDGE * max(float(np.trace(gram)) / max(len(gram), 1), 1e-30)
    products = np.concatenate(
        [motion[n : n + _ROWS].reshape(len(motion[n : n + _ROWS]), -1) @ flat.T for n in range(0, len(motion), _ROWS)]
    )
    weights = bounded_least_squares(gram, products, np.asarray(lower, float), np.asarray(upper, float))
    return KeyFit(weights, *mix_errors(motion, keys, weights))


def mix_errors(motion: FloatArray, keys: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Largest and root mean square distance of the vertices from `motion` where `keys` are mixed by `weights`."""
    flat = np.ascontiguousarray(keys, dtype=np.float32).reshape(len(keys), -1)
    worst, total = 0.0, 0.0
    for n in range(0, len(motion), _ROWS):
        part = motion[n : n + _ROWS]
        mixed: NDArray[np.float32] = weights[n : n + _ROWS].astype(np.float32) @ flat
        squared = np.square(mixed.reshape(part.shape) - part).sum(axis=2, dtype=np.float64)
        worst, total = max(worst, float(squared.max(initial=0.0))), total + float(squared.sum())
    return float(np.sqrt(worst)), float(np.sqrt(total / max(motion.shape[0] * motion.shape[1], 1)))
