"""Least squares within bounds, for weights of shape keys (method.md, section 9.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import linalg
from .arrays import FloatArray

_TOLERANCE = 1e-10
"""Gradient at a bound, relative to the largest number of the system, below which a variable stays there."""
_STEPS = 200
"""Number of projected gradient steps, after which most active bounds are known."""
_FEW = 4
"""Number of rows up to which these steps take longer than finding the active bounds one by one."""


def bounded_least_squares(
    gram: FloatArray,
    products: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    start: FloatArray | None = None,
) -> FloatArray:
    """Minimise ``|A x - y|^2`` exactly, subject to ``lower <= x <= upper``, for many y: solutions (N, K).

    Parameters
    ----------
    gram : (K, K) array
        ``A^T A``, positive definite.
    products : (N, K) array
        ``A^T y``, one row per y.
    lower, upper : (K,) array
        Bounds, which may be infinite, with ``lower < upper``.
    start : (N, K) array, optional
        Points near the solutions, such as those of similar y. The solutions do not depend on them, but take less time.

    Raises
    ------
    ValueError
        If a number is not finite.

    Notes
    -----
    Accelerated projected gradients (Beck & Teboulle 2009) for all rows at once find most active bounds in a few matrix
    products. An active-set method (Stark & Parker 1995) on the normal equations then solves each row exactly, which is
    fast as K is small. scipy's `lsq_linear` with its active-set method takes 7 to 12 times as long for 52 keys and 200
    rows, from the factor of the normal equations, whichever numpy is used.
    """
    gram, products = np.asarray(gram, dtype=np.float64), np.asarray(products, dtype=np.float64)
    _largest(gram, products)
    if start is None and len(products) > _FEW:
        result = _approximate(gram, products, lower, upper)
    else:
        result = np.clip(np.zeros_like(products) if start is None else start, lower, upper)
    for x, product in zip(result, products, strict=True):
        _solve(gram, product, lower, upper, x, (x > lower) & (x < upper))
    return result


def bounded_minimum(
    gram: FloatArray, product: FloatArray, lower: FloatArray, upper: FloatArray, start: FloatArray
) -> FloatArray:
    """Minimise ``x^T gram x / 2 - product^T x`` as `bounded_least_squares` does, from a point near the minimum."""
    return np.asarray(bounded_least_squares(gram, product[None], lower, upper, start[None])[0])


def _approximate(gram: FloatArray, products: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return rows (N, K) near the solution, within the bounds, by accelerated projected gradients."""
    # Scale unknowns to a unit diagonal, which evens out the steps.
    unit = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled, wanted = gram * np.outer(unit, unit), products * unit
    low, high = lower / unit, upper / unit
    step = 1.0 / max(float(linalg.eigvalsh(scaled)[-1]) if len(scaled) else 1.0, 1e-300)
    x = np.clip(np.zeros_like(products), low, high)
    ahead, speed = x, 1.0
    for _ in range(_STEPS):
        before, x = x, np.clip(ahead - step * (linalg.multiply(ahead, scaled) - wanted), low, high)
        # Nesterov's momentum.
        faster = (1.0 + np.sqrt(1.0 + 4.0 * speed**2)) / 2.0
        ahead, speed = x + (speed - 1.0) / faster * (x - before), faster
    return np.asarray(np.clip(x * unit, lower, upper))


def _largest(gram: FloatArray, products: FloatArray) -> float:
    """Return the size of a system's largest numbers, which have to be finite."""
    largest = float(np.abs(products).max(initial=0.0) + np.abs(gram).max(initial=0.0))
    if not largest < np.inf:
        raise ValueError("The system contains numbers that are not finite.")
    return largest


def _solve(
    gram: FloatArray, product: FloatArray, lower: FloatArray, upper: FloatArray, x: FloatArray, free: NDArray[np.bool_]
) -> None:
    """Move `x` to the minimum (Stark & Parker 1995), in place; `free` marks the variables off their bounds."""
    tolerance = _TOLERANCE * max(_largest(gram, product), 1e-300)
    _descend(gram, product, lower, upper, x, free)
    for _ in range(64 * len(gram)):  # terminates, as the objective falls with each step; the limit is for rounding
        slope = gram @ x - product
        wrong = np.where(x <= lower, -slope, np.where(x >= upper, slope, 0.0))
        wrong[free] = 0.0
        worst = int(np.argmax(wrong)) if len(wrong) else 0
        if not len(wrong) or wrong[worst] <= tolerance:
            return
        # Free the variable that gains most by leaving its bound.
        free[worst] = True
        _descend(gram, product, lower, upper, x, free)


def _descend(
    gram: FloatArray, product: FloatArray, lower: FloatArray, upper: FloatArray, x: FloatArray, free: NDArray[np.bool_]
) -> None:
    """Minimise over the free variables, in place; those that reach a bound on the way stay there."""
    while free.any():
        rows = np.flatnonzero(free)
        right = product[rows] - gram[rows] @ np.where(free, 0.0, x)
        step = linalg.solve_definite(gram[rows[:, None], rows], right) - x[rows]
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
