"""Least squares within bounds, for weights of shape keys: non-negative, and never more than a slider goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

_TOLERANCE = 1e-10
_STEPS = 200


def bounded_least_squares(gram: FloatArray, products: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """(N, K) rows x that minimise |A x - y|^2 for `lower <= x <= upper`, exactly, each row for its own y.

    Parameters
    ----------
    gram : (K, K) array
        A^T A, positive definite.
    products : (N, K) array
        A^T y, a row for each y.
    lower, upper : (K,) array
        May be infinite; `lower < upper`.

    Notes
    -----
    All rows together by accelerated projected gradients (Beck and Teboulle, SIAM Journal on Imaging Sciences 2, 2009),
    which find most of what is at a bound in a few matrix products; then each row exactly by the active-set method of
    Stark and Parker (Bounded-variable least squares, Computational Statistics 10, 1995) from there, on the normal
    equations, as K is small and N large.
    """
    gram, products = np.asarray(gram, dtype=np.float64), np.asarray(products, dtype=np.float64)
    result = _near(gram, products, lower, upper)
    for x, product in zip(result, products, strict=True):
        _solve(gram, product, lower, upper, x, (x > lower) & (x < upper))
    return result


def _near(gram: FloatArray, products: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """(N, K) rows near the solution, within the bounds; each unknown in its own unit, so that steps are alike."""
    unit = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled, wanted = gram * np.outer(unit, unit), products * unit
    low, high = lower / unit, upper / unit
    step = 1.0 / max(float(np.linalg.norm(scaled, 2)) if len(scaled) else 1.0, 1e-300)
    x = np.clip(np.zeros_like(products), low, high)
    ahead, speed = x, 1.0
    for _ in range(_STEPS):
        before, x = x, np.clip(ahead - step * (ahead @ scaled - wanted), low, high)
        faster = (1.0 + np.sqrt(1.0 + 4.0 * speed**2)) / 2.0
        ahead, speed = x + (speed - 1.0) / faster * (x - before), faster
    return np.asarray(np.clip(x * unit, lower, upper))


def _solve(
    gram: FloatArray, product: FloatArray, lower: FloatArray, upper: FloatArray, x: FloatArray, free: NDArray[np.bool_]
) -> None:
    """Move `x` to the minimum; `free` are the variables off their bounds. Both are changed in place."""
    tolerance = _TOLERANCE * max(float(np.abs(product).max(initial=0.0)), float(np.abs(gram).max(initial=0.0)), 1e-300)
    _descend(gram, product, lower, upper, x, free)
    for _ in range(64 * len(gram)):  # the objective falls with each, so that no active set comes twice; rounding apart
        slope = gram @ x - product
        wrong = np.where(x <= lower, -slope, np.where(x >= upper, slope, 0.0))
        wrong[free] = 0.0
        worst = int(np.argmax(wrong)) if len(wrong) else 0
        if not len(wrong) or wrong[worst] <= tolerance:
            return
        free[worst] = True
        _descend(gram, product, lower, upper, x, free)


def _descend(
    gram: FloatArray, product: FloatArray, lower: FloatArray, upper: FloatArray, x: FloatArray, free: NDArray[np.bool_]
) -> None:
    """Minimise over the free variables; one that meets a bound on the way stays there."""
    while free.any():
        rows, fixed = np.flatnonzero(free), np.flatnonzero(~free)
        right = product[rows] - gram[np.ix_(rows, fixed)] @ x[fixed]
        step = np.linalg.solve(gram[np.ix_(rows, rows)], right) - x[rows]
        bound = np.where(step > 0.0, upper[rows], lower[rows])
        room = np.divide(bound - x[rows], step, out=np.full(len(rows), np.inf), where=step != 0.0)
        share = float(room.min())
        if share >= 1.0:
            x[rows] += step
            return
        met = rows[room <= share]
        x[rows] += max(share, 0.0) * step
        x[met] = bound[room <= share]
        free[met] = False
