"""Curves with few keyframes, as an animator draws them: cubic Bezier segments that stay within an error of the motion
that they cause together (method.md, section 9.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply
from .bezier import BezierCurve, segments

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
_SHRINK, _STRONGEST = 0.9, 0.3
"""Factor of the error of a curve in a frame in which all together err too much, beyond what would suffice if all became
better by it; and the least."""
_MAIN = 0.7
"""Share of the largest part in the error of a frame from which a curve has to come closer there. At .5 there are 5 %
more keyframes, as more curves do."""
_ROUNDS = 40
"""Largest number of fits."""
_SAMPLE = 600
"""Number of vertices that are measured before the last fits."""
_FLAT = 1e-6
"""Range of a curve, and step within a plateau, that counts as none."""
_AT_ONCE, _SPANS_AT_ONCE = 64, 256
"""Numbers of frames and of spans processed at a time."""


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
        points = moved.reshape(len(moved), -1, 3)
        found[n : n + _AT_ONCE] = np.einsum("nvc,nvc->nv", points, points).max(axis=1, initial=0.0)
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
    for i, value in enumerate(values.tolist()):
        if rising >= 0 and value > values[high]:
            high = i
        if rising <= 0 and value < values[low]:
            low = i
        if rising >= 0 and values[high] - value > prominence:
            turns.append(high)
            rising, low = -1, i
        elif rising <= 0 and value - values[low] > prominence:
            turns.append(low)
            rising, high = 1, i
    if rising:
        turns.append(high if rising > 0 else low)
    found = {0, len(values) - 1, *turns}
    for turn in turns:
        flat = np.abs(values[turn:] - values[turn]) > _FLAT
        found.add(turn + (int(flat.argmax()) if flat.any() else len(flat)) - 1)
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
        allowed, rows = np.ascontiguousarray(tolerances.T), np.flatnonzero(chosen & self._moving)
        for n in range(0, len(rows), _SPANS_AT_ONCE):
            self._fit(allowed, rows[n : n + _SPANS_AT_ONCE])
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
        """Fit spans (R,), all at once, segment by segment."""
        curve, at, stop = self.spans[rows].T.copy()
        before = np.zeros(len(rows))
        for i, row in enumerate(rows.tolist()):
            if kept := self._kept(allowed, row):
                at[i], before[i] = self._rows[row][kept - 1], self._slopes[row][2 * kept - 1]
            self._rows[row], self._slopes[row] = self._rows[row][:kept], self._slopes[row][: 2 * kept]
        live = np.flatnonzero(at < stop)
        while len(live):
            found = self._longest(allowed, _Starts(curve, at, stop, before).chosen(live))
            at[live] += found.lengths
            before[live] = found.end
            steps = zip(rows[live].tolist(), at[live].tolist(), found.start.tolist(), found.end.tolist(), strict=True)
            for row, frame, first, last in steps:
                self._rows[row].append(frame)
                self._slopes[row] += [first, last]
            live = live[at[live] < stop[live]]

    def _kept(self, allowed: FloatArray, row: int) -> int:
        """Return how many segments at the start of a span stay as they are: those that end before a tolerance is new.

        With smaller tolerances behind its end, a segment would not become longer.
        """
        curve, first, last = self.spans[row].tolist()
        new, used = allowed[curve, first + 1 : last], self._used[curve, first + 1 : last]
        changed = np.flatnonzero(new != used)
        used[:] = new
        if not self._fitted[row]:
            self._fitted[row] = True
            return 0
        if not len(changed):
            return len(self._rows[row])
        return int(np.searchsorted(self._rows[row], first + 1 + changed[0], side="right"))

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
        # Relative to the start, single precision is enough, and takes half of the time.
        own, origin = self._values[curve[:, None], columns], self._values[curve, at, None]
        values, limits = (own - origin).astype(np.float32), allowed[curve[:, None], columns].astype(np.float32)
        low, high = ((limit[curve, None] - origin).astype(np.float32) for limit in (self._low, self._high))
        before, counts = before.astype(np.float32), np.arange(1, len(table.rise) + 1)
        lengths, last = counts.astype(np.float32), values[:, 1:]
        # What the slopes have to explain at the inner frames of a segment of each length, (R, L, L + 1).
        left = values[:, None] - table.rise * last[..., None]
        left *= table.inner
        possible = counts <= reach[:, None]

        def judged(start: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
            """Slopes (R, L) at the ends after those at the starts, and whether the segments are within tolerance."""
            rest = left - table.start * start[..., None]
            end = np.einsum("rli,li->rl", rest, table.last)
            end = np.where(counts == 1, last, end)
            end = np.clip(end, 3.0 * (last - high) / lengths, 3.0 * (last - low) / lengths)
            rest -= table.end * end[..., None]
            return end, possible & (np.abs(rest) <= limits[:, None]).all(axis=2)

        lowest, highest = 3.0 * low / lengths, 3.0 * high / lengths
        free = np.einsum("rli,li->rl", left, table.first)
        free = np.clip(np.where(counts == 1, last, free), lowest, highest)
        smooth = np.clip(np.broadcast_to(before[:, None], free.shape), lowest, highest)
        rows = np.arange(len(curve))
        chosen = _Longest(np.ones(len(curve), dtype=np.intp), np.zeros(len(curve)), np.zeros(len(curve)))
        for start, bonus in ((free, 1.0), (smooth, 1.0 / _ALIGNED)):
            end, fits = judged(start)
            found = np.maximum(np.where(fits, counts, 0).max(axis=1), 1)
            better = found * bonus >= chosen.lengths
            for out, part in zip(chosen, (found, start[rows, found - 1], end[rows, found - 1]), strict=True):
                out[better] = part[better]
        # Segments that end at a stop are level there, where they stay within tolerance.
        of = chosen.lengths - 1
        off = np.abs(left[rows, of] - table.start[of] * chosen.start[:, None])
        chosen.end[(chosen.lengths == reach) & (chosen.lengths > 1) & (off <= limits).all(axis=1)] = 0.0
        return chosen


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
