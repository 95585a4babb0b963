"""Curves with few keyframes, as an animator draws them: cubic Bezier segments that stay within an error of the motion
that they cause together (method.md, section 9.5).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply, squared_lengths
from .bezier import BezierCurve, Segments, segments

_SHARE = 0.6
"""Error of a single curve at first, as a share of that of all together. At .5 there are 2 to 4 % more keyframes; at .7
a fit takes a fifth longer, for none fewer.
"""
_COARSEST = 0.2
"""Largest error of a value of a key, however little it moves: other programs may read it."""
_PROMINENCE = 3.2
"""Height of a peak that is a keyframe, in errors. At 1.6 there are 9 to 10 % more keyframes."""
_ALIGNED = 0.8
"""Length of a segment with the slope of the one before, as a share of that of a free one, from which it is preferred.
At .6, 42 % of the keyframes are smooth instead of 33 %, and there are 6 to 9 % more.
"""
_LENGTHS = (16, 40, 100, 256)
"""Longest segments in frames, in each attempt; most have about 10."""
_SHRINK = 0.9
"""Factor of the error of a curve in a frame in which all together err too much, beyond what would suffice if all became
better by it."""
_STRONGEST = 0.3
"""Least value of that factor."""
_MAIN = 0.7
"""Share of the largest part in the error of a frame from which a curve has to come closer there. At .5 there are 5 %
more keyframes, as more curves do."""
_ROUNDS = 40
"""Largest number of fits."""
_SAMPLE = 600
"""Number of vertices that are measured before the last fits."""
_FLAT = 1e-6
"""Range of a curve, and step within a plateau, that counts as none."""
_SAME = 1e-9
"""Difference of slopes, per frame, that is due to rounding."""
_AT_ONCE = 64
"""Number of frames processed at a time."""
_SPANS_AT_ONCE = 256
"""Number of spans processed at a time."""
_CHECKED = 64_000
"""Frames of segments, of all lengths, that are checked at a time, which fit into the CPU's second-level cache."""


def fit_key_curves(
    values: FloatArray, offsets: FloatArray, tolerance: float, lower: FloatArray, upper: FloatArray
) -> list[BezierCurve]:
    """Fit curves with few keyframes to values of shape keys in successive frames.

    Parameters
    ----------
    values : (N, K) array
        Values of the keys.
    offsets : (K, V, 3) array
        Displacements of the vertices by each key at value 1.
    tolerance : float
        Largest distance of a vertex, in a frame, from where the values put it, in the unit of `offsets`.
    lower, upper : (K,) array
        Range of each key, within which its curve stays between frames too, if its values do.

    Returns
    -------
    list of BezierCurve
        One curve for each key. Prominent peaks, and both ends of those that are plateaus, are keyframes with their
        exact value.

    Notes
    -----
    Segments are made as long as possible, one after the other, by least squares for the slopes at their ends. Each
    curve may err by a share of the tolerance at first, and by less in frames in which the mesh errs too much.

    Examples
    --------
    >>> from facemime import fit_key_curves
    >>> swing = np.sin(np.linspace(0.0, 6.0, 100))[:, None]
    >>> (curve,) = fit_key_curves(swing, np.ones((1, 5, 3)), 0.01, [-1.0], [1.0])
    >>> len(curve.rows) < 10, bool(np.abs(curve.at(np.arange(100.0)) - swing[:, 0]).max() < 0.01)
    (True, True)
    """
    values = np.asarray(values, dtype=np.float64)
    flat = np.ascontiguousarray(offsets, dtype=np.float32)
    peaks = np.sqrt(np.square(flat).sum(axis=2, dtype=np.float64).max(axis=1, initial=0.0))
    each = tolerance / np.maximum(peaks, tolerance / _COARSEST)
    few = flat[:, :: max(1, flat.shape[1] // _SAMPLE)]
    rows = np.arange(len(values), dtype=np.float64)
    stops = [stops_of(column, height) for column, height in zip(values.T, (_PROMINENCE * each).tolist(), strict=True)]
    allowed = np.tile(_SHARE * each, (len(values), 1))
    fit = _Fit(values, stops, lower, upper)
    fit.renew(allowed, np.ones(len(fit.spans), dtype=bool))
    curves, errors = fit.curves(), np.full_like(values, np.inf)
    new, measured, distances = np.arange(values.shape[1]), few, np.zeros(len(values))
    for _ in range(_ROUNDS):
        renewed = np.column_stack([curves[k].at(rows) for k in new]) - values[:, new]
        changed = (renewed != errors[:, new]).any(axis=1)
        errors[:, new] = renewed
        distances[changed] = _distances(errors[changed], measured)
        if distances.max(initial=0.0) <= tolerance and measured is not flat:
            measured = flat
            distances = _distances(errors, measured)
        far = np.flatnonzero(distances > tolerance)
        if not len(far):
            break
        # Only what moves the mesh most there has to come closer.
        parts = np.abs(errors[far]) / each
        main = parts >= _MAIN * parts.max(axis=1, keepdims=True)
        factor = np.maximum(_SHRINK * tolerance / distances[far], _STRONGEST)[:, None]
        allowed[far] = np.where(main, np.minimum(allowed[far], factor * np.abs(errors[far])), allowed[far])
        new = fit.renew(allowed, fit.spans_with(np.abs(errors) > allowed))
        for k in new:
            curves[k] = fit.curve(k)
    return curves


def _distances(weights: FloatArray, offsets: NDArray[np.float32]) -> FloatArray:
    """Largest displacement of a vertex in each frame, (N,), for weights (N, K) of `offsets` (K, V, 3)."""
    flat, found = offsets.reshape(len(offsets), -1), np.empty(len(weights))
    for n in range(0, len(weights), _AT_ONCE):
        moved = multiply(weights[n : n + _AT_ONCE].astype(np.float32), flat)
        squared = squared_lengths(moved.reshape(len(moved), -1, 3))
        found[n : n + _AT_ONCE] = squared.max(axis=1, initial=0.0)
    return np.sqrt(found)


def fit_curves(
    values: FloatArray,
    tolerances: FloatArray,
    stops: Sequence[NDArray[np.intp]],
    lower: FloatArray,
    upper: FloatArray,
) -> list[BezierCurve]:
    """Fit curves to values (N, K) in successive frames, each within its tolerances (N, K) of these.

    There is a keyframe with the exact value at each of the K `stops`, as `stops_of` returns them. N is at least 1.
    """
    fit = _Fit(np.asarray(values, dtype=np.float64), stops, lower, upper)
    fit.renew(np.broadcast_to(tolerances, np.shape(values)), np.ones(len(fit.spans), dtype=bool))
    return fit.curves()


def stops_of(values: FloatArray, prominence: float) -> NDArray[np.intp]:
    """Return both ends of values (N,), their peaks and valleys that are higher than `prominence`, and, where these are
    plateaus, both ends of them: ascending indices.
    """
    turns, low, high, rising = [0], 0, 0, 0
    # Only where the direction changes, and at the end, is there anything to decide.
    steps = np.sign(np.diff(values))
    moving = np.flatnonzero(steps)
    ends = moving[np.append(np.diff(steps[moving]) != 0.0, True)[: len(moving)]] + 1
    given = values.tolist()
    for i in ends.tolist():
        value = given[i]
        if rising >= 0 and value > given[high]:
            high = i
        if rising <= 0 and value < given[low]:
            low = i
        if rising >= 0 and given[high] - value > prominence:
            turns.append(high)
            rising, low = -1, i
        elif rising <= 0 and value - given[low] > prominence:
            turns.append(low)
            rising, high = 1, i
    if rising:
        turns.append(high if rising > 0 else low)
    found = {0, len(given) - 1}
    for turn in turns:
        last = turn
        while last + 1 < len(given) and abs(given[last + 1] - given[turn]) <= _FLAT:
            last += 1
        found |= {turn, last}
    return np.array(sorted(found), dtype=np.intp)


class _Fit:
    """Fits curves to values (N, K) with keyframes at `stops` of each.

    From stop to stop a curve is a span, which does not depend on others.

    Attributes
    ----------
    spans : (S, 3) intp
        Curve, first and last frame of each span.
    """

    def __init__(
        self, values: FloatArray, stops: Sequence[NDArray[np.intp]], lower: FloatArray, upper: FloatArray
    ) -> None:
        self._values = np.ascontiguousarray(values.T)
        low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
        self._low = np.minimum(low, self._values.min(axis=1))
        self._high = np.maximum(high, self._values.max(axis=1))
        own = [np.column_stack([np.full(len(at) - 1, k), at[:-1], at[1:]]) for k, at in enumerate(stops)]
        self.spans = np.concatenate([np.empty((0, 3), dtype=np.intp), *own])
        self._first = np.searchsorted(self.spans[:, 0], np.arange(len(self._values) + 1))
        self._rows: list[list[int]] = [[last] for last in self.spans[:, 2].tolist()]
        self._slopes: list[list[float]] = [[0.0, 0.0] for _ in self.spans]
        flat = [np.ptp(self._values[k, first : last + 1]) <= _FLAT for k, first, last in self.spans.tolist()]
        self._moving = ~np.array(flat, dtype=bool)
        self._used = np.full_like(self._values, np.inf)
        self._fitted = np.zeros(len(self.spans), dtype=bool)

    def spans_with(self, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which spans, (S,), have a marked frame, (N, K), within."""
        counts = np.pad(marked.T.cumsum(axis=1), ((0, 0), (1, 0)))
        curve, first, last = self.spans.T
        return np.asarray(counts[curve, last + 1] > counts[curve, first])

    def renew(self, tolerances: FloatArray, chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Fit the chosen spans, (S,), within tolerances (N, K), which must not grow from call to call.

        Returns the curves of which they are a part.
        """
        rows = np.flatnonzero(chosen & self._moving)
        self._fit(np.ascontiguousarray(tolerances.T), rows)
        return np.asarray(np.unique(self.spans[rows, 0]), dtype=np.intp)

    def curves(self) -> list[BezierCurve]:
        """Return all curves."""
        return [self.curve(k) for k in range(len(self._values))]

    def curve(self, k: int) -> BezierCurve:
        """Return a curve."""
        own = range(self._first[k], self._first[k + 1])
        rows = [0, *(row for span in own for row in self._rows[span])]
        slopes = [slope for span in own for slope in self._slopes[span]] or [0.0, 0.0]
        sides = np.array([slopes[0], *slopes, slopes[-1]] if len(rows) > 1 else slopes).reshape(-1, 2)
        return BezierCurve(np.array(rows, dtype=np.intp), self._values[k, rows], sides)

    def _fit(self, allowed: FloatArray, rows: NDArray[np.intp]) -> None:
        """Fit spans (R,), many at once, segment by segment."""
        curve, at, stop = self.spans[rows].T.copy()
        before, earlier = np.zeros(len(rows)), []
        for i, row in enumerate(rows.tolist()):
            kept, settled = self._kept(allowed, row)
            earlier.append(_Earlier(self._rows[row], self._slopes[row], settled))
            if kept:
                at[i], before[i] = self._rows[row][kept - 1], self._slopes[row][2 * kept - 1]
            self._rows[row], self._slopes[row] = self._rows[row][:kept], self._slopes[row][: 2 * kept]
        # The longest first, so that no span is left over to be fitted alone.
        waiting = np.argsort(at - stop, kind="stable")
        while len(live := waiting[at[waiting] < stop[waiting]][:_SPANS_AT_ONCE]):
            found = self._longest(allowed, _Starts(curve, at, stop, before).chosen(live))
            at[live] += found.lengths
            before[live] = found.end
            steps = zip(live.tolist(), at[live].tolist(), found.start.tolist(), found.end.tolist(), strict=True)
            for i, frame, first, last in steps:
                rest = earlier[i].rest(frame, last)
                self._rows[rows[i]] += [frame, *earlier[i].rows[rest:]]
                self._slopes[rows[i]] += [first, last, *earlier[i].slopes[2 * rest :]]
                if rest < len(earlier[i].rows):
                    at[i] = stop[i]

    def _kept(self, allowed: FloatArray, row: int) -> tuple[int, int]:
        """Return how many segments at the start of a span stay as they are, which are those that end before a tolerance
        is new, and the last frame with a new one.

        With smaller tolerances behind its end, a segment would not become longer.
        """
        curve, first, last = self.spans[row].tolist()
        new, used = allowed[curve, first + 1 : last], self._used[curve, first + 1 : last]
        changed = np.flatnonzero(new != used)
        used[:] = new
        if not self._fitted[row]:
            self._fitted[row] = True
            return 0, last
        if not len(changed):
            return len(self._rows[row]), first
        return int(np.searchsorted(self._rows[row], first + 1 + changed[0], side="right")), first + 1 + int(changed[-1])

    def _longest(self, allowed: FloatArray, starts: _Starts) -> _Longest:
        """Find the longest segments."""
        found = self._within(allowed, starts, _LENGTHS[0])
        for shorter, longest in pairwise(_LENGTHS):
            full = np.flatnonzero((found.lengths == shorter) & (starts.stop > starts.at + shorter))
            if not len(full):
                break
            for out, part in zip(found, self._within(allowed, starts.chosen(full), longest), strict=True):
                out[full] = part
        return found

    def _within(self, allowed: FloatArray, starts: _Starts, longest: int) -> _Longest:
        """Find the longest segments of at most `longest` frames."""
        curve, at, stop, before = starts
        reach = stop - at
        table = segments(min(longest, int(reach.max())))
        columns = np.minimum(at[:, None] + np.arange(table.rise.shape[1]), self._values.shape[1] - 1)
        values = self._values[curve[:, None], columns] - self._values[curve, at, None]
        low, high = (limit[curve, None] - self._values[curve, at, None] for limit in (self._low, self._high))
        counts, last = np.arange(1, len(table.rise) + 1), values[:, 1:]
        # Slopes at the starts, free or as that of the segment before, and at the ends after them, (2, R, L).
        free = multiply(values, table.first.T)
        start = np.stack([free, np.broadcast_to(before[:, None], free.shape)])
        np.clip(start, 3.0 * low / counts, 3.0 * high / counts, out=start)
        end = multiply(values, table.last.T) + table.follows * start
        np.clip(end, 3.0 * (last - high) / counts, 3.0 * (last - low) / counts, out=end)
        limits = allowed[curve[:, None], columns]
        fits = _within_limits(table, values, limits, start, end) & (counts <= reach[:, None])
        alone, smooth = np.maximum(np.where(fits, counts, 0).max(axis=2), 1)
        side, rows = (smooth / _ALIGNED >= alone).astype(np.intp), np.arange(len(curve))
        lengths = np.where(side, smooth, alone)
        of = lengths - 1
        chosen = _Longest(lengths, start[side, rows, of], end[side, rows, of])
        # Segments that end at a stop are level there, where they stay within tolerance.
        level = values - table.rise[of] * last[rows, of, None] - table.start[of] * chosen.start[:, None]
        fits_level = ((np.abs(level) <= limits) | table.outer[of]).all(axis=1)
        chosen.end[(lengths == reach) & (lengths > 1) & fits_level] = 0.0
        return chosen


def _within_limits(
    table: Segments, values: FloatArray, limits: FloatArray, start: FloatArray, end: FloatArray
) -> NDArray[np.bool_]:
    """Return whether segments of each length with some slopes (2, R, L) are within limits (R, L + 1) of values."""
    fits, (rows, frames) = np.empty(start.shape, dtype=np.bool_), values.shape
    # Relative to the start, single precision is enough, and takes half of the time.
    values, limits, start, end = (part.astype(np.float32) for part in (values, limits, start, end))
    step = max(1, _CHECKED // frames**2)
    for n in range(0, rows, step):
        own = slice(n, n + step)
        left = values[own, None] - table.rise * values[own, 1:, None]
        for side in range(2):
            off = left - table.start * start[side, own, :, None]
            off -= table.end * end[side, own, :, None]
            np.abs(off, out=off)
            fits[side, own] = ((off <= limits[own, None]) | table.outer).all(axis=2)
    return fits


class _Earlier(NamedTuple):
    """The segments of a span, as in `_Fit`, before tolerances changed, and the last frame in which they did."""

    rows: list[int]
    slopes: list[float]
    settled: int

    def rest(self, frame: int, slope: float) -> int:
        """Return from where on the segments stay as they are if new ones reach a frame with a slope."""
        at = bisect_left(self.rows, frame)
        met = at < len(self.rows) and self.rows[at] == frame and frame >= self.settled
        return at + 1 if met and abs(self.slopes[2 * at + 1] - slope) < _SAME else len(self.rows)


class _Starts(NamedTuple):
    """Where segments start, (R,) each: curve, frame, frame that they must not pass, and slope of the segment before."""

    curve: NDArray[np.intp]
    at: NDArray[np.intp]
    stop: NDArray[np.intp]
    before: FloatArray

    def chosen(self, rows: NDArray[np.intp]) -> _Starts:
        """Return some of them."""
        return _Starts(self.curve[rows], self.at[rows], self.stop[rows], self.before[rows])


class _Longest(NamedTuple):
    """The longest segments that were found: frames, and slopes at their ends, (R,) each."""

    lengths: NDArray[np.intp]
    start: FloatArray
    end: FloatArray
