"""The motion of vertices as shape keys: a small basis of new ones, in place of one per frame (method.md, section 9.1),
or those that a mesh already has, fitted (section 9.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..files.large_arrays import large_array
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_least_squares
from ..numeric.linalg import multiply, squared_lengths

_WORST = 8
"""Number of frames in which modes are added until those frames are within the tolerance."""
_SPARE = 16
"""Mixtures of frames, beyond the number of modes, with which long motions are searched for modes."""
_POWER_ITERATIONS = 2
"""Iterations of that search."""
_LONG = 4
"""Number of frames per mixture from which a motion is long."""
RIDGE = 1e-4
"""Ridge as a share of the mean square of a key. Similar keys then share motion, and undetermined ones stay at 0."""
_NEGLIGIBLE = 1e-3
"""Largest weight in a direction, of 1 in the other, that is left out when a mode is split."""
_FRAMES_AT_ONCE = 64
"""Number of frames processed at a time."""


@dataclass(frozen=True)
class MotionBasis:
    """A motion as a product, ``motion[n] ~ sum_k weights[n, k] modes[k]``.

    Attributes
    ----------
    modes : (K, V, 3) float32
        Displacements at weight 1. The largest absolute weight of each mode over the motion is 1.
    weights : (N, K) float32
        Weights, -1 to 1.
    worst_error : float
        Largest distance of a vertex in any frame from the motion, in its unit.
    """

    modes: NDArray[np.float32]
    weights: NDArray[np.float32]
    worst_error: float


def fit_basis(motion: FloatArray, tolerance: float, max_modes: int = 64) -> MotionBasis:
    """Fit the smallest basis of singular vectors with a vertex error within `tolerance`.

    Parameters
    ----------
    motion : (N, V, 3) array
        Displacements from rest.
    tolerance : float
        Largest allowed distance of a vertex, in the unit of `motion`.
    max_modes : int
        Largest number of modes. If it does not suffice, `worst_error` exceeds the tolerance.

    Returns
    -------
    MotionBasis
        The basis.

    Notes
    -----
    The singular vectors of short motions are exact. Those of long ones are found within the span of a few mixtures of
    the frames, refined by two power iterations (Halko, Martinsson & Tropp 2011, algorithm 4.4), as the exact ones would
    cost O(N^2 V): here it is O(N V K).

    Examples
    --------
    >>> from facemime import fit_basis
    >>> motion = np.random.default_rng(0).standard_normal((20, 100, 3))
    >>> basis = fit_basis(motion, tolerance=1e-3)
    >>> basis.weights.shape, bool(basis.worst_error < 1e-3)
    ((20, 20), True)
    """
    frames, vertices = motion.shape[:2]
    flat = np.ascontiguousarray(motion, dtype=np.float32).reshape(frames, -1)
    # Singular vectors from a Gram matrix, the strongest first, without those that consist of rounding errors.
    span = _span(flat, max_modes + _SPARE)
    spanned = flat if span is None else multiply(span.T, flat)
    values, vectors = linalg.eigh(multiply(spanned, spanned.T).astype(np.float64))
    strongest = values[-1] if values[-1] > 0 else 1.0
    order = [i for i in np.argsort(values)[::-1][:max_modes] if values[i] > 1e-10 * strongest]
    modes = multiply((vectors[:, order] / np.sqrt(values[order])).T, spanned)
    weights = (vectors[:, order] * np.sqrt(values[order])).astype(np.float32)
    weights = weights if span is None else multiply(span, weights)
    count, worst = _smallest(flat, weights, modes, tolerance)
    weights, modes = weights[:, :count], modes[:count]
    # Scale each mode so that its largest weight is 1, which suits the range of a slider.
    peak = weights[np.abs(weights).argmax(axis=0), np.arange(count)] if count else np.ones(0, dtype=np.float32)
    return MotionBasis(
        modes=np.ascontiguousarray((modes * peak[:, None]).reshape(count, vertices, 3)),
        weights=np.ascontiguousarray(weights / peak),
        worst_error=worst,
    )


def fit_positive_basis(motion: FloatArray, tolerance: float, max_modes: int = 64) -> MotionBasis:
    """Fit a basis as `fit_basis` does, whose weights are 0 to 1: modes that move both ways become two.

    Parameters are as there. If there would be more than `max_modes`, half as many singular vectors are used.
    """
    split = _split(fit_basis(motion, tolerance, max_modes))
    if len(split.modes) > max_modes > 1:
        split = _split(fit_basis(motion, tolerance, max_modes // 2))
    return split


def _split(basis: MotionBasis) -> MotionBasis:
    """Return a basis with a mode for each direction in which one of `basis` moves."""
    modes, weights = [], []
    for mode, column in zip(basis.modes, basis.weights.T, strict=True):
        for side in (1.0, -1.0):
            peak = float((side * column).max(initial=0.0))
            if peak > _NEGLIGIBLE:
                modes.append(side * peak * mode)
                weights.append(np.clip(side * column, 0.0, None) / peak)
    shape = len(weights), len(basis.weights)
    return MotionBasis(
        modes=np.array(modes, dtype=np.float32).reshape(-1, *basis.modes.shape[1:]),
        weights=np.ascontiguousarray(np.reshape(weights, shape).T, dtype=np.float32),
        worst_error=basis.worst_error,
    )


def _span(flat: NDArray[np.float32], count: int) -> NDArray[np.float32] | None:
    """Orthonormal columns (N, count) that nearly span the strongest left singular vectors of `flat` (N, 3 V).

    None if there are too few frames for this to be worthwhile.
    """
    if len(flat) <= _LONG * count:
        return None
    mixed = multiply(np.random.default_rng(0).standard_normal((count, len(flat)), np.float32), flat)
    for _ in range(_POWER_ITERATIONS):
        mixed = multiply(linalg.qr(multiply(flat, mixed.T), mode="economic")[0].T, flat)
    span: NDArray[np.float32] = linalg.qr(multiply(flat, mixed.T), mode="economic")[0]
    return span


def _smallest(
    flat: NDArray[np.float32], weights: NDArray[np.float32], modes: NDArray[np.float32], tolerance: float
) -> tuple[int, float]:
    """Return how many modes bring the worst vertex of the worst frame within the tolerance, or all, and its distance.

    Modes are added in the frames that were worst, and all frames are looked at only when those are within.
    """
    count, worst = 0, _worst(flat, weights[:, :0], modes[:0])
    while worst.max(initial=0.0) > tolerance and count < len(modes):
        rows = np.argsort(worst)[-_WORST:]
        residual = flat[rows] - multiply(weights[rows, :count], modes[:count])
        while count < len(modes):
            residual -= np.outer(weights[rows, count], modes[count])
            count += 1
            if _farthest(residual).max() <= tolerance:
                break
        worst = _worst(flat, weights[:, :count], modes[:count])
    return count, float(worst.max(initial=0.0))


def _worst(flat: NDArray[np.float32], weights: NDArray[np.float32], modes: NDArray[np.float32]) -> FloatArray:
    """Largest distance of a vertex from the motion in each frame, (N,).

    Works on a few frames at a time, so that no second array of the size of the motion is allocated.
    """
    found = [_farthest(flat[part] - multiply(weights[part], modes)) for part in _parts(len(flat))]
    return np.concatenate(found) if found else np.zeros(0)


def _farthest(residual: NDArray[np.float32]) -> FloatArray:
    """Largest distance of a vertex in each frame of a residual (N, 3 V), (N,)."""
    squared = squared_lengths(residual.reshape(len(residual), -1, 3))
    return np.asarray(np.sqrt(squared.max(axis=1, initial=0.0)))


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
    weights = fit_weights(motion, keys, lower, upper, exclusive)
    return KeyFit(weights, *mix_errors(motion, keys, weights))


def fit_weights(
    motion: FloatArray,
    keys: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    exclusive: Sequence[tuple[int, int]] = (),
) -> FloatArray:
    """Fit only the weights (N, K) of `fit_keys`."""
    flat = np.ascontiguousarray(keys, dtype=np.float64).reshape(len(keys), -1)
    # Normal equations of equation 9.1, in which the motion enters only by its products with the keys.
    gram = multiply(flat, flat.T)
    gram[np.diag_indices(len(gram))] += RIDGE * max(float(np.trace(gram)) / max(len(gram), 1), 1e-30)
    moved = motion.reshape(len(motion), -1)
    products = np.concatenate([multiply(moved[part].astype(np.float64), flat.T) for part in _parts(len(moved))])
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    weights = bounded_least_squares(gram, products, low, high)
    if pairs := [pair for pair in exclusive if low[list(pair)].max() <= 0.0]:
        _exclude(weights, np.array(pairs, dtype=np.intp), gram, products, low, high)
    return weights


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
        changed = np.unique(rows)
        # Rows without the same keys are fitted together.
        patterns, of = np.unique(left_out[changed], axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            alike, kept = changed[of.reshape(-1) == number], np.flatnonzero(~pattern)
            own = np.ix_(alike, kept)
            # Without a weak key, the others are nearly the same.
            weights[own] = bounded_least_squares(
                gram[np.ix_(kept, kept)], products[own], lower[kept], upper[kept], weights[own]
            )
            weights[np.ix_(alike, np.flatnonzero(pattern))] = 0.0


def mixed_motion(keys: FloatArray, weights: FloatArray) -> NDArray[np.float32]:
    """Return the motion (N, V, 3) of a mix of shape keys (K, V, 3) by weights (N, K)."""
    flat = np.ascontiguousarray(keys, dtype=np.float32).reshape(len(keys), -1)
    motion = large_array((len(weights), *keys.shape[1:]))
    for part in _parts(len(weights)):
        motion[part] = multiply(weights[part], flat).reshape(motion[part].shape)
    return motion


def mix_errors(motion: FloatArray, keys: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Return the largest and the root mean square distance of vertices from a motion, for a mix of shape keys.

    The weights are (N, K); the other arrays are as for `fit_keys`.
    """
    flat = np.ascontiguousarray(keys, dtype=np.float32).reshape(len(keys), -1)
    worst, total = 0.0, 0.0
    for part in _parts(len(motion)):
        squared = squared_lengths(multiply(weights[part], flat).reshape(motion[part].shape) - motion[part])
        worst, total = max(worst, float(squared.max(initial=0.0))), total + float(squared.sum(dtype=np.float64))
    return float(np.sqrt(worst)), float(np.sqrt(total / max(motion.shape[0] * motion.shape[1], 1)))


def left_over(motion: FloatArray, keys: FloatArray, weights: FloatArray) -> tuple[NDArray[np.float32], float]:
    """Return what a mix of shape keys leaves of a motion, (N, V, 3), and the length of the largest vector in it.

    Arrays are as for `mix_errors`.
    """
    flat = np.ascontiguousarray(keys, dtype=np.float32).reshape(len(keys), -1)
    left, worst = large_array(motion.shape), 0.0
    for part in _parts(len(motion)):
        own = left[part]
        np.subtract(motion[part], multiply(weights[part], flat).reshape(own.shape), out=own)
        worst = max(worst, float(squared_lengths(own).max(initial=0.0)))
    return left, float(np.sqrt(worst))


def _parts(frames: int) -> list[slice]:
    """Divide frames into parts that are processed at a time."""
    return [slice(n, n + _FRAMES_AT_ONCE) for n in range(0, frames, _FRAMES_AT_ONCE)]
