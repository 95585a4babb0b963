"""Cubic Bezier curves: Hermite's cubics, and least squares for the slopes at the ends of segments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray


def hermite(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hermite's cubics at shares `s` of a segment: of the rise, and of the slopes at its start and end."""
    return (3.0 - 2.0 * s) * s**2, s * (1.0 - s) ** 2, -(s**2) * (1.0 - s)


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
        rise, start, end = hermite(s)
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


class Segments(NamedTuple):
    """Least squares for segments of 1 to L frames with given ends, (L, L + 1) each: row `l - 1` is a segment of l
    frames, column i its frame i; 0 beyond its inner frames.

    Attributes
    ----------
    outer : bool
        Whether it is not an inner frame.
    rise, start, end : float32
        Hermite's cubics there.
    first : float64
        Factors of the values, from the value at the start, whose sum is the slope at the start.
    last : float64
        The same for the slope at the end, if that at the start is 0.
    follows : (L,) float64
        Factor of the slope at the start in that at the end.
    """

    outer: NDArray[np.bool_]
    rise: NDArray[np.float32]
    start: NDArray[np.float32]
    end: NDArray[np.float32]
    first: FloatArray
    last: FloatArray
    follows: FloatArray


@cache
def segments(longest: int) -> Segments:
    """Return the least squares for segments of up to `longest` frames."""
    lengths, frames = np.arange(1, longest + 1)[:, None], np.arange(longest + 1)[None, :]
    inner = (frames > 0) & (frames < lengths)
    rise, start, end = (np.where(inner, part, 0.0) for part in hermite(frames / lengths))
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
    follows = -(last * start).sum(axis=1)
    # What the slopes have to explain is the values without the rise to the last one; a single step is straight.
    for factors in (first, last):
        factors[lengths[:, 0] - 1, lengths[:, 0]] = np.where(lengths[:, 0] == 1, 1.0, -(factors * rise).sum(axis=1))
    rise, start, end = (part.astype(np.float32) for part in (rise, start, end))
    return Segments(~inner, rise, start, end, first, last, follows)
