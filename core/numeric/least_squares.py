"""Least squares within bounds, for weights of shape keys (method.md, section 9.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import linalg
from .arrays import FloatArray

_TOLERANCE = 1e-10
"""Gradient at a bound, relative to the largest number of the system, below which a variable stays there."""
_STEPS = 50
"""Number of projected gradient steps, after which most active bounds are known. For 52 keys and a minute of the shared
clips, 25 take a fifth longer in all, and 200 a third."""
_TRIES = 3
"""Exchanges after which fewer variables have to be wrong."""
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
    products. Block pivoting (Júdice & Pires 1994) on the normal equations then solves each row exactly, which is fast
    as K is small; where it comes no nearer, an active-set method (Stark & Parker 1995) does. scipy's `lsq_linear` with
    its active-set method takes more than ten times as long for 52 keys and 200 rows, from the factor of the normal
    equations.
    """
    gram, products = np.asarray(gram, dtype=np.float64), np.asarray(products, dtype=np.float64)
    largest = _largest(gram)
    tolerances = [_tolerance(largest, product) for product in products]
    if start is None and len(products) > _FEW:
        result = _approximate(gram, products, lower, upper)
    else:
        result = np.clip(np.zeros_like(products) if start is None else start, lower, upper)
    for x, product, tolerance in zip(result, products, tolerances, strict=True):
        _solve(gram, product, lower, upper, x, (x > lower) & (x < upper), tolerance)
    return result


def bounded_minimum(
    gram: FloatArray,
    product: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    start: FloatArray,
    opposite: NDArray[np.intp] | None = None,
) -> FloatArray:
    """Minimise ``x^T gram x / 2 - product^T x`` as `bounded_least_squares` does, from a point near the minimum.

    `opposite` has the other variable of each pair of which only one may be above its lower bound of 0, or -1; what is
    found then is a minimum near `start`, which may not be the lowest.
    """
    x = np.clip(start, lower, upper)
    paired = opposite if opposite is not None and (opposite >= 0).any() else None
    tolerance = _tolerance(_largest(gram), product)
    _solve(gram, product, lower, upper, x, (x > lower) & (x < upper), tolerance, paired)
    return x


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


def _largest(numbers: FloatArray) -> float:
    return float(np.abs(numbers).max(initial=0.0))


def _tolerance(largest: float, product: FloatArray) -> float:
    """Return the gradient at a bound that counts as none, by a system's largest numbers, which have to be finite."""
    size = largest + _largest(product)
    if not size < np.inf:
        raise ValueError("The system contains numbers that are not finite.")
    return _TOLERANCE * max(size, 1e-300)


def _solve(
    gram: FloatArray,
    product: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    x: FloatArray,
    free: NDArray[np.bool_],
    tolerance: float,
    opposite: NDArray[np.intp] | None = None,
) -> None:
    """Move `x` to the minimum, in place; `free` marks the variables off their bounds."""
    if _pivot(gram, product, lower, upper, x, free, tolerance, opposite):
        return
    np.clip(x, lower, upper, out=x)
    free &= (x > lower) & (x < upper)
    _descend(gram, product, lower, upper, x, free)
    for _ in range(64 * len(gram)):  # terminates, as the objective falls with each step; the limit is for rounding
        slope = gram @ x - product
        wrong = np.where(x <= lower, -slope, np.where(x >= upper, slope, 0.0))
        wrong[free | (lower >= upper)] = 0.0
        if opposite is not None:
            wrong[(opposite >= 0) & (x[opposite] > 0.0)] = 0.0
        worst = int(np.argmax(wrong)) if len(wrong) else 0
        if not len(wrong) or wrong[worst] <= tolerance:
            return
        # Free the variable that gains most by leaving its bound (Stark & Parker 1995).
        free[worst] = True
        _descend(gram, product, lower, upper, x, free)


def _pivot(
    gram: FloatArray,
    product: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    x: FloatArray,
    free: NDArray[np.bool_],
    tolerance: float,
    opposite: NDArray[np.intp] | None = None,
) -> bool:
    """Move `x` to the minimum by exchanging all variables that are wrong at once (Júdice & Pires 1994), in place.

    Return whether that was reached: not if the number of wrong variables does not fall any more.
    """
    fewest, tries = len(x) + 1, _TRIES
    while tries:
        rows = free.nonzero()[0]
        if len(rows):
            own = gram[rows]
            x[rows] = 0.0
            x[rows] = linalg.solve_definite(own[:, rows], product[rows] - own @ x)
        slope = gram @ x - product
        below, above = free & (x < lower), free & (x > upper)
        leaving = ~free & np.where(x <= lower, slope < -tolerance, (x >= upper) & (slope > tolerance))
        leaving &= lower < upper
        if opposite is not None:
            rising = np.where(leaving & (x <= lower), slope, 0.0) / np.sqrt(np.diag(gram))
            leaving &= (rising == 0.0) | _one_way(rising, x > 0.0, opposite)
        wrong = int(np.count_nonzero(below) + np.count_nonzero(above) + np.count_nonzero(leaving))
        if not wrong:
            return True
        tries = _TRIES if wrong < fewest else tries - 1
        fewest = min(fewest, wrong)
        x[below], x[above] = lower[below], upper[above]
        free[:] = (free & ~below & ~above) | leaving
    return False


def _one_way(slope: FloatArray, used: NDArray[np.bool_], opposite: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which variables may leave 0, (K,): those whose opposite is neither used nor falls more steeply."""
    order = np.arange(len(slope))
    steeper = (slope[opposite] < slope) | ((slope[opposite] == slope) & (opposite < order))
    return np.asarray((opposite < 0) | ~(used[opposite] | steeper))


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
