"""A small basis for a long motion: what a take of vertex positions is baked into instead of one shape key a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray


@dataclass(frozen=True)
class MotionBasis:
    """`motion[n] ~ sum_k weights[n, k] modes[k]`.

    Attributes
    ----------
    modes : (K, V, 3) float32
        Displacements at weight 1; the largest |weight| of each mode over the motion is 1.
    weights : (N, K) float32
        -1 to 1.
    worst_error : float
        The largest distance of any vertex in any frame from the motion, in the motion's unit.
    """

    modes: NDArray[np.float32]
    weights: NDArray[np.float32]
    worst_error: float


def fit_basis(motion: FloatArray, tolerance: float, max_modes: int = 64) -> MotionBasis:
    """The fewest modes, by singular values, whose worst vertex error stays below `tolerance`.

    Parameters
    ----------
    motion : (N, V, 3) array
        Displacements from rest.
    tolerance : float
        In the unit of `motion`.
    max_modes : int
        Where it does not suffice, `worst_error` says what was reached.

    Notes
    -----
    O(N^2 V): the eigenvectors of the N x N Gram matrix give the singular vectors, as N is far below 3 V.
    """
    frames, vertices = motion.shape[:2]
    flat = np.ascontiguousarray(motion, dtype=np.float32).reshape(frames, -1)
    values, vectors = np.linalg.eigh((flat @ flat.T).astype(np.float64))
    strongest = values[-1] if values[-1] > 0 else 1.0
    order = [i for i in np.argsort(values)[::-1][:max_modes] if values[i] > 1e-10 * strongest]
    weights = (vectors[:, order] * np.sqrt(values[order])).astype(np.float32)
    modes = ((vectors[:, order] / np.sqrt(values[order])).T.astype(np.float32)) @ flat
    residual = flat.copy()
    count = 0
    worst = _worst(residual, vertices)
    while worst > tolerance and count < len(order):
        residual -= np.outer(weights[:, count], modes[count])
        count += 1
        worst = _worst(residual, vertices)
    weights, modes = weights[:, :count], modes[:count]
    peak = weights[np.abs(weights).argmax(axis=0), np.arange(count)] if count else np.ones(0, dtype=np.float32)
    return MotionBasis(
        modes=np.ascontiguousarray((modes * peak[:, None]).reshape(count, vertices, 3)),
        weights=np.ascontiguousarray(weights / peak),
        worst_error=worst,
    )


def _worst(residual: NDArray[np.float32], vertices: int) -> float:
    squared = np.square(residual).reshape(len(residual), vertices, 3).sum(axis=2)
    return float(np.sqrt(squared.max(initial=0.0)))
