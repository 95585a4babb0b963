"""Fewer keys on a curve: only those that straight lines between them need to stay near all the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray


def needed_keys(times: FloatArray, values: FloatArray, tolerance: float) -> NDArray[np.intp]:
    """Indices, ascending, of the keys to keep so that lines between them are nowhere further than `tolerance` away.

    Parameters
    ----------
    times, values : (N,) array
        Times increase. The distance is that of values at the same time, not across the line.
    tolerance : float
        In the unit of `values`; 0 keeps every key that is not on the line.

    Notes
    -----
    Douglas and Peucker (Cartographica 10, 1973), with spans on a list instead of calls. The tolerance holds at the
    keys; as the curve is straight between them, it holds everywhere.
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
