"""Fitting of a motion of vertices by shape keys that a mesh already has (method.md, section 9.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_least_squares
from ..numeric.linalg import multiply

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


def fit_keys(
    motion: FloatArray,
    keys: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    exclusive: Sequence[tuple[int, int]] = (),
) -> KeyFit:
    """Fit weights of shape keys to a motion, by least squares within bounds.

    Parameters
    ----------
    motion : (N, V, 3) array
        Displacements from rest.
    keys : (K, V, 3) array
        Displacements at weight 1.
    lower, upper : (K,) array
        Range of the weight of each key.
    exclusive : sequence of (int, int)
        Pairs of keys with opposite motions. In each frame, at least one of a pair is 0.

    Returns
    -------
    KeyFit
        Weights and errors.

    Notes
    -----
    Equation 9.1. Where both keys of a pair are found, the weaker one is left out and the others are fitted again.

    Examples
    --------
    >>> from facemime import fit_keys
    >>> keys = np.random.default_rng(0).standard_normal((4, 100, 3))
    >>> fit = fit_keys(0.5 * keys[:2], keys, np.zeros(4), np.ones(4))
    >>> fit.weights.round(2).tolist()
    [[0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]]
    """
    flat = np.ascontiguousarray(keys, dtype=np.float64).reshape(len(keys), -1)
    # Normal equations of equation 9.1, in which the motion enters only by its products with the keys.
    gram = multiply(flat, flat.T)
    gram[np.diag_indices(len(gram))] += RIDGE * max(float(np.trace(gram)) / max(len(gram), 1), 1e-30)
    parts = (motion[n : n + _ROWS] for n in range(0, len(motion), _ROWS))
    products = np.concatenate([multiply(part.reshape(len(part), -1).astype(np.float64), flat.T) for part in parts])
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    weights = bounded_least_squares(gram, products, low, high)
    if pairs := [pair for pair in exclusive if low[list(pair)].max() <= 0.0]:
        _exclude(weights, np.array(pairs, dtype=np.intp), gram, products, low, high)
    return KeyFit(weights, *mix_errors(motion, keys, weights))


def _exclude(
    weights: FloatArray,
    pairs: NDArray[np.intp],
    gram: FloatArray,
    products: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> None:
    """Fit weights (N, K) again without the weaker keys of `pairs` (P, 2) until no pair is together, in place."""
    left_out = np.zeros(weights.shape, dtype=bool)
    for _ in pairs:
        both = (np.abs(weights[:, pairs]) > 0.0).all(axis=2)
        rows, chosen = np.nonzero(both)
        if not len(rows):
            return
        weaker = pairs[chosen, np.abs(weights[rows[:, None], pairs[chosen]]).argmin(axis=1)]
        left_out[rows, weaker] = True
        for row in np.unique(rows):
            kept = np.flatnonzero(~left_out[row])
            weights[row] = 0.0
            weights[row, kept] = bounded_least_squares(
                gram[np.ix_(kept, kept)], products[row : row + 1, kept], lower[kept], upper[kept]
            )[0]


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
