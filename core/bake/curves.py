"""Curves with few keyframes, as an animator draws them: cubic Bezier segments that stay within an error of the motion
that they cause together (method.md, section 9.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply

_SHARE = 0.5
"""Error of a single curve at first, as a share of that of all together. At .6 a fit takes half as long again, and there
are 2 to 4 % fewer keyframes.
"""
_COARSEST = 0.2
"""Largest error of a value of a key, however little it moves: other programs may read it."""
_PROMINENCE = 3.2
"""Height of a peak that is a keyframe, in errors. More than twice as many peaks, at 1.6, cost 8 % more keyframes."""
_ALIGNED = 0.8
"""Length of a segment with the slope of the one before, as a share of that of a free one, from which it is preferred.
At .6, two thirds of the keyframes are smooth instead of half, but there are 10 % more.
"""
_LENGTHS = (16, 64, 256)
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
_AT_ONCE = 64
"""Number of frames processed at a time."""


@dataclass(frozen=True)
class BezierCurve:
    """A curve of cubic Bezier segments with handles at a third of each, so that it is a function of time.

    Attributes
    ----------
    rows : (K,) intp
        Frames of the keyframes, ascending, from the first.
    values : (K,) float64
        Values of the keyframes.
    slopes : (K, 2) float64
        Slopes before and after each keyframe, per frame.
    """

    rows: NDArray[np.intp]
    values: FloatArray
    slopes: FloatArray

    def at(self, rows: FloatArray) -> FloatArray:
        """Return the values (N,) at `rows` (N,), frames from the first."""
        if len(self.rows) == 1:
            return np.full(len(rows), self.values[0])
        after = np.clip(np.searchsorted(self.rows, rows, side="right"), 1, len(self.rows) - 1)
        before = after - 1
        length = (self.rows[after] - self.rows[before]).astype(np.float64)
        s = (rows - self.rows[before]) / length
        rise, start, end = _hermite(s)
        return np.asarray(
            self.values[before]
            + rise * (self.values[after] - self.values[before])
            + length * (start * self.slopes[before, 1] + end * self.slopes[after, 0])
        )

    def handles(self) -> tuple[FloatArray, FloatArray]:
        """Return the left and right handles, (K, 2) each: frame from the first, and value."""
        steps = np.pad(np.diff(self.rows) / 3.0, 1, mode="edge") if len(self.rows) > 1 else np.full(2, 1.0 / 3.0)
        both = steps[:-1], steps[1:]
        left, right = (
            np.column_stack([self.rows + sign * step, self.values + sign * step * slope])
            for sign, step, slope in zip((-1.0, 1.0), both, self.slopes.T, strict=True)
        )
        return left, right

    @property
    def smooth(self) -> NDArray[np.bool_]:
        """Whether the slope is the same on both sides of each keyframe, (K,)."""
        return np.isclose(self.slopes[:, 0], self.slopes[:, 1], rtol=1e-6, atol=1e-9)


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
    values, lower, upper = (np.asarray(part, dtype=np.float64) for part in (values, lower, upper))
    flat = np.ascontiguousarray(offsets, dtype=np.float32)
    peaks = np.sqrt(np.square(flat).sum(axis=2, dtype=np.float64).max(axis=1, initial=0.0))
    each = tolerance / np.maximum(peaks, tolerance / _COARSEST)
    few = flat[:, :: max(1, flat.shape[1] // _SAMPLE)]
    rows = np.arange(len(values), dtype=np.float64)
    stops = [stops_of(column, height) for column, height in zip(values.T, (_PROMINENCE * each).tolist(), strict=True)]
    allowed = np.tile(_SHARE * each, (len(values), 1))
    curves, errors = fit_curves(values, allowed, stops, lower, upper), np.empty_like(values)
    new, measured = np.arange(values.shape[1]), few
    for _ in range(_ROUNDS):
        errors[:, new] = np.column_stack([curves[k].at(rows) for k in new]) - values[:, new]
        distances = _distances(errors, measured)
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
        new = np.flatnonzero((np.abs(errors) > allowed).any(axis=0))
        again = fit_curves(values[:, new], allowed[:, new], [stops[k] for k in new], lower[new], upper[new])
        for k, curve in zip(new, again, strict=True):
            curves[k] = curve
    return curves


def _distances(weights: FloatArray, offsets: NDArray[np.float32]) -> FloatArray:
    """Largest displacement of a vertex in each frame, (N,), for weights (N, K) of `offsets` (K, V, 3)."""
    flat, found = offsets.reshape(len(offsets), -1), np.empty(len(weights))
    for n in range(0, len(weights), _AT_ONCE):
        moved = multiply(weights[n : n + _AT_ONCE].astype(np.float32), flat)
        found[n : n + _AT_ONCE] = np.square(moved.reshape(len(moved), -1, 3)).sum(axis=2).max(axis=1, initial=0.0)
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
    values = np.asarray(values, dtype=np.float64)
    curves: list[BezierCurve | None] = [_still(column) for column in values.T]
    moving = [k for k, curve in enumerate(curves) if curve is None]
    if moving:
        within, allowed = values[:, moving].T, np.broadcast_to(tolerances, values.shape)[:, moving].T
        low = np.minimum(np.asarray(lower, float)[moving], within.min(axis=1))
        high = np.maximum(np.asarray(upper, float)[moving], within.max(axis=1))
        fit = _Fit(within, allowed, low, high, [stops[k] for k in moving])
        for k, curve in zip(moving, fit.curves(), strict=True):
            curves[k] = curve
    return [curve for curve in curves if curve is not None]


def _still(values: FloatArray) -> BezierCurve | None:
    """Return a flat curve, with a keyframe at each end; None if the values (N,) differ."""
    if len(values) > 1 and np.ptp(values) > _FLAT:
        return None
    rows = np.unique([0, len(values) - 1])
    return BezierCurve(rows, np.full(len(rows), values[0]), np.zeros((len(rows), 2)))


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


def _hermite(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hermite's cubics at shares `s` of a segment: of the rise, and of the slopes at its start and end."""
    return (3.0 - 2.0 * s) * s**2, s * (1.0 - s) ** 2, -(s**2) * (1.0 - s)


class _Segments(NamedTuple):
    """Least squares for segments of 1 to L frames with given ends, (L, L + 1) each: row `l - 1` is a segment of l
    frames, column i its frame i; 0 beyond its inner frames.

    Attributes
    ----------
    inner : bool
        Whether it is an inner frame.
    rise, start, end : float64
        Hermite's cubics there.
    first : float64
        Factors of the inner frames whose sum is the slope at the start.
    last : float64
        The same for that at the end, if that at the start is given.
    """

    inner: NDArray[np.bool_]
    rise: FloatArray
    start: FloatArray
    end: FloatArray
    first: FloatArray
    last: FloatArray


@cache
def _segments(longest: int) -> _Segments:
    lengths, frames = np.arange(1, longest + 1)[:, None], np.arange(longest + 1)[None, :]
    inner = (frames > 0) & (frames < lengths)
    rise, start, end = (np.where(inner, part, 0.0) for part in _hermite(frames / lengths))
    start, end = start * lengths, end * lengths
    # Normal equations of the two slopes; a single inner frame determines their difference alone, and the shortest
    # solution is taken.
    aa, ab, bb = (start**2).sum(axis=1), (start * end).sum(axis=1), (end**2).sum(axis=1)
    determinant = aa * bb - ab**2
    single = lengths[:, 0] == 2
    determinant[single | (determinant <= 0.0)] = np.inf
    first = (bb[:, None] * start - ab[:, None] * end) / determinant[:, None]
    first[single] = start[single] / (aa + bb)[single, None]
    last = np.divide(end, bb[:, None], out=np.zeros_like(end), where=bb[:, None] > 0.0)
    return _Segments(inner, rise, start, end, first, last)


class _Fit:
    """Fits curves to values (C, N), all at once, segment by segment, with keyframes at `stops` of each."""

    def __init__(
        self,
        values: FloatArray,
        tolerances: FloatArray,
        low: FloatArray,
        high: FloatArray,
        stops: Sequence[NDArray[np.intp]],
    ) -> None:
        self._values, self._tolerances = np.ascontiguousarray(values), np.ascontiguousarray(tolerances)
        self._range = low[:, None], high[:, None]
        count, frames = values.shape
        # For each frame, the next stop after it, and whether it is one.
        self._stop = np.zeros((count, frames), dtype=bool)
        for row, at in zip(self._stop, stops, strict=True):
            row[at] = True
        following = np.where(self._stop, np.arange(frames), frames)
        following = np.minimum.accumulate(following[:, ::-1], axis=1)[:, ::-1]
        self._next = np.column_stack([following[:, 1:], np.full(count, frames - 1)])

    def curves(self) -> list[BezierCurve]:
        """Return one curve for each row of the values."""
        count, frames = self._values.shape
        rows: list[list[int]] = [[0] for _ in range(count)]
        slopes: list[list[float]] = [[] for _ in range(count)]
        at, before = np.zeros(count, dtype=np.intp), np.zeros(count)
        live = np.arange(count)
        while len(live):
            lengths, start, end = self._longest(live, at[live], before[live])
            at[live] += lengths
            before[live] = end
            for c, row, first, last in zip(live.tolist(), at[live].tolist(), start, end, strict=True):
                rows[c].append(row)
                slopes[c] += [first, last]
            live = live[at[live] < frames - 1]
        return [self._curve(c, rows[c], slopes[c]) for c in range(count)]

    def _curve(self, c: int, rows: list[int], slopes: list[float]) -> BezierCurve:
        sides = np.array([slopes[0], *slopes, slopes[-1]]).reshape(-1, 2)
        return BezierCurve(np.array(rows, dtype=np.intp), self._values[c, rows], sides)

    def _longest(self, live: NDArray[np.intp], at: NDArray[np.intp], before: FloatArray) -> _Longest:
        """Find the longest segments of curves `live` (C,) from frames `at` (C,), after the slopes `before` (C,)."""
        found = self._within(live, at, before, _LENGTHS[0])
        for shorter, longest in pairwise(_LENGTHS):
            full = np.flatnonzero((found.lengths == shorter) & (self._next[live, at] > at + shorter))
            if not len(full):
                break
            more = self._within(live[full], at[full], before[full], longest)
            for out, part in zip(found, more, strict=True):
                out[full] = part
        return found

    def _within(self, live: NDArray[np.intp], at: NDArray[np.intp], before: FloatArray, longest: int) -> _Longest:
        """Find the longest segments of at most `longest` frames."""
        table, frames = _segments(longest), self._values.shape[1]
        columns = np.minimum(at[:, None] + np.arange(longest + 1), frames - 1)
        values, allowed = self._values[live[:, None], columns], self._tolerances[live[:, None], columns]
        low, high = self._range[0][live], self._range[1][live]
        lengths = np.arange(1, longest + 1)
        first, last = values[:, :1], values[:, 1:]
        # What the slopes have to explain at the inner frames of a segment of each length, (C, L, L + 1).
        left = values[:, None] - first[..., None] - table.rise * (last - first)[..., None]
        left *= table.inner
        reach = self._next[live, at] - at
        possible = lengths <= reach[:, None]

        def judged(start: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
            """Slopes (C, L) at the ends after those at the starts, and whether the segments are within tolerance."""
            rest = left - table.start * start[..., None]
            end = (rest * table.last).sum(axis=2)
            end = np.where(lengths == 1, last - first, end)
            end = np.clip(end, 3.0 * (last - high) / lengths, 3.0 * (last - low) / lengths)
            off = np.abs(rest - table.end * end[..., None])
            return end, possible & (off <= allowed[:, None]).all(axis=2)

        lowest, highest = 3.0 * (low - first) / lengths, 3.0 * (high - first) / lengths
        free = (left * table.first).sum(axis=2)
        free = np.clip(np.where(lengths == 1, last - first, free), lowest, highest)
        smooth = np.where(self._stop[live, at], 0.0, before)[:, None]
        smooth = np.clip(np.broadcast_to(smooth, free.shape), lowest, highest)
        rows = np.arange(len(live))
        chosen = _Longest(np.ones(len(live), dtype=np.intp), np.zeros(len(live)), np.zeros(len(live)))
        for start, bonus in ((free, 1.0), (smooth, 1.0 / _ALIGNED)):
            end, fits = judged(start)
            found = np.where(fits, lengths, 0).max(axis=1)
            found = np.maximum(found, 1)
            better = found * bonus >= chosen.lengths
            for out, part in zip(chosen, (found, start[rows, found - 1], end[rows, found - 1]), strict=True):
                out[better] = part[better]
        self._flatten(chosen, reach, left, allowed, table)
        return chosen

    def _flatten(
        self,
        chosen: _Longest,
        reach: NDArray[np.intp],
        left: FloatArray,
        allowed: FloatArray,
        table: _Segments,
    ) -> None:
        """Let segments that end at a stop be level there, in place, where they stay within tolerance."""
        rows = np.arange(len(reach))
        of = chosen.lengths - 1
        off = np.abs(left[rows, of] - table.start[of] * chosen.start[:, None])
        level = (chosen.lengths == reach) & (chosen.lengths > 1) & (off <= allowed).all(axis=1)
        chosen.end[level] = 0.0


class _Longest(NamedTuple):
    """The longest segments that were found: frames, and slopes at their ends, (C,) each."""

    lengths: NDArray[np.intp]
    start: FloatArray
    end: FloatArray
