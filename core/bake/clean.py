"""Removal of keyframes that straight lines between the others replace (method.md, section 9.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray


def needed_keys(times: FloatArray, values: FloatArray, tolerance: float) -> NDArray[np.intp]:
    """Select the keyframes that a polyline needs to stay within a tolerance of all keyframes.

    Parameters
    ----------
    times : (N,) array
        Times of the keyframes, increasing.
    values : (N,) array
        Values of the keyframes; errors are differences in value at the same time.
    tolerance : float
        Largest allowed error, in the unit of `values`; 0 keeps every keyframe that is off the line.

    Returns
    -------
    (n,) int
        Indices of the keyframes to keep, ascending.

    Notes
    -----
    The algorithm of Douglas & Peucker 1973, without recursion. The error is bounded at the keyframes, and therefore
    everywhere, as the curve between them is straight.
    """
    count = len(values)
    if count < 3:
        return np.arange(count)
    kept = np.zeros(count, dtype=np.bool_)
    kept[[0, count - 1]] = True
    spans = [(0, count - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner = slice(first + 1, last)
        share = (times[inner] - times[first]) / (times[last] - times[first])
        away = np.abs(values[inner] - values[first] - share * (values[last] - values[first]))
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = first + 1 + worst
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return np.flatnonzero(kept)
