"""Smoothing a take, whole: as it is done live, or without any delay, since what comes later is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import FacemimeError
from ..tracking.smoothing import SHAPE_PARTS, ResultSmoother
from .take import Take, TakeRecorder
from .timing import project

CUTOFFS: dict[str, float] = {
    "brows": 4.0,
    "right eye": 9.0,
    "left eye": 9.0,
    "nose": 3.0,
    "mouth": 7.0,
    "jaw": 6.0,
    "rotation": 4.0,
    "place": 4.0,
    "gaze": 8.0,
}
"""Hz at which half of a movement passes, part by part."""
_LOWEST, _HIGHEST = 1e-3, 1e5
"""Hz: of a cutoff, and from which on nothing is smoothed."""
_LONGEST_STEP = 0.25
_SHORTEST_STEP = 1e-3
"""Seconds that frames count as apart at least: where a part was punched in, two may be nearly at one time."""
_FEWEST = 5


def smooth_take(take: Take, amount: float = 1.0) -> Take:
    """`take` with every frame smoothed as `ResultSmoother` does live; a take that is smooth already is given back."""
    if amount <= 0.0 or take.info.get("smoothed"):
        return take
    smoother, recorder = ResultSmoother(amount), TakeRecorder({**take.info, "smoothed": "one-euro"})
    for frame, time in enumerate(take.times.tolist()):
        recorder.append(time, smoother.smooth(take.result(frame), time))
    return recorder.finish()


def smooth_zero_phase(take: Take, cutoffs: Mapping[str, float] | None = None) -> Take:
    """`take` smoothed without delay, each part of the face with its own cutoff.

    Pose, shape and gaze are smoothed, and the landmarks follow. Nothing is drawn across a loss of the face.

    Parameters
    ----------
    cutoffs : mapping, optional
        Hz by part, in place of those in `CUTOFFS`; `inf` leaves a part as it is.

    Raises
    ------
    FacemimeError
        For a part that is none and a cutoff that is too low.
    """
    chosen = {**CUTOFFS, **(cutoffs or {})}
    for part, cutoff in chosen.items():
        if part not in CUTOFFS or not cutoff >= _LOWEST:
            raise FacemimeError(
                f"{part}={cutoff:g} is no cutoff. Give {_LOWEST:g} Hz or more for one of: {', '.join(CUTOFFS)}."
            )
    shape, pose, gaze = take.shape.astype(np.float64), take.pose.copy(), take.gaze.astype(np.float64)
    for run in _runs(take.times, take.found):
        for part, (rows, _) in SHAPE_PARTS.items():
            flat = shape[run][:, rows].reshape(len(run), -1)
            shape[np.ix_(run, rows)] = low_pass(take.times[run], flat, chosen[part]).reshape(len(run), -1, 3)
        pose[run, 1:4] = low_pass(take.times[run], np.unwrap(pose[run, 1:4], axis=0), chosen["rotation"])
        place = np.column_stack([np.log(pose[run, 0]), pose[run, 4:6]])
        place = low_pass(take.times[run], place, chosen["place"])
        pose[run, 0], pose[run, 4:6] = np.exp(place[:, 0]), place[:, 1:]
    for run in _runs(take.times, np.isfinite(take.gaze).all(axis=1)):
        gaze[run] = low_pass(take.times[run], gaze[run], chosen["gaze"])
    landmarks = take.landmarks.copy()
    landmarks[take.found] = project(shape[take.found], pose[take.found])
    changed: dict[str, Any] = {
        "shape": shape.astype(np.float32),
        "gaze": gaze.astype(np.float32),
        "landmarks": landmarks,
    }
    return replace(take, pose=pose, **changed, info={**take.info, "smoothed": "zero-phase"})


def _runs(times: FloatArray, known: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
    """The rows of each stretch of known frames that follow each other without a gap, if there are enough to smooth."""
    rows = np.flatnonzero(known)
    breaks = np.flatnonzero((np.diff(rows) > 1) | (np.diff(times[rows]) > _LONGEST_STEP)) + 1
    yield from (run for run in np.split(rows, breaks) if len(run) >= _FEWEST)


def low_pass(times: FloatArray, values: FloatArray, cutoff: float) -> FloatArray:
    """(N, D) `values` at increasing `times` (N,) without what swings faster than `cutoff`, Hz; nothing is delayed.

    Notes
    -----
    The z that minimises `sum_i h_i |z_i - y_i|^2 + integral |z''|^2 / (2 pi f_c)^4`, with h_i the time that a frame
    stands for (Whittaker 1923; Eilers, Analytical Chemistry 75, 2003). Its gain `1 / (1 + (f / f_c)^4)` is that of a
    Butterworth filter of second order run forward and backward, without the filter's transients at both ends and
    without its need of even times. A straight line passes unchanged. Pentadiagonal, so the cost is linear in N.
    """
    if not cutoff < _HIGHEST:
        return values
    steps = np.maximum(np.diff(times), _SHORTEST_STEP)
    share = np.convolve(steps, [0.5, 0.5])
    middle = 0.5 * (steps[1:] + steps[:-1])
    # A row of the second difference: z'' at the middle of three frames, times the root of the time it stands for.
    weight = np.sqrt(middle) / (middle * (2.0 * pi * cutoff) ** 2)
    first, last = weight / steps[:-1], weight / steps[1:]
    rows = np.stack([first, -(first + last), last])
    bands = np.zeros((3, len(times)))
    bands[0] = share
    for i in range(3):
        bands[0, i : i + len(middle)] += rows[i] ** 2
        for j in range(i + 1, 3):
            bands[j - i, i : i + len(middle)] += rows[i] * rows[j]
    return _solve_pentadiagonal(bands, share[:, None] * values)


def _solve_pentadiagonal(bands: FloatArray, right: FloatArray) -> FloatArray:
    """(N, D) solution for a symmetric positive definite matrix by its factors L D L^T.

    `bands[k, i]` (3, N) couples the unknowns i and i + k.
    """
    count = len(right)
    main, near, far = (band.tolist() for band in bands)
    # Two rows of an identity before the first row, and two of nothing behind the last, so that no end is special.
    d, c, e = [1.0, 1.0], [0.0, 0.0], [0.0, 0.0]
    z = np.zeros((count + 4, right.shape[1]))
    for i in range(count):
        e.append(far[i - 2] / d[i] if i > 1 else 0.0)
        c.append((near[i - 1] - e[-1] * c[-1] * d[i]) / d[i + 1] if i > 0 else 0.0)
        d.append(main[i] - c[-1] ** 2 * d[i + 1] - e[-1] ** 2 * d[i])
        z[i + 2] = right[i] - c[-1] * z[i + 1] - e[-1] * z[i]
    z[2 : count + 2] /= np.array(d[2:])[:, None]
    c, e = [*c, 0.0, 0.0], [*e, 0.0, 0.0]
    for i in range(count + 1, 1, -1):
        z[i] -= c[i + 1] * z[i + 1] + e[i + 2] * z[i + 2]
    return z[2 : count + 2]


@dataclass(frozen=True)
class Curves:
    """How a part moves before and after mending: one number a frame, in eye distances, radians for turns.

    Attributes
    ----------
    times, before : (N,)
    mended_times, after : (M,)
    """

    times: FloatArray
    before: FloatArray
    mended_times: FloatArray
    after: FloatArray


def before_after(take: Take, mended: Take, part: str) -> Curves:
    """The curves of a part of `CUTOFFS` in the direction in which it moves most in `take`; NaN where unknown."""
    before, after = _PART_VALUES[part](take), _PART_VALUES[part](mended)
    known = np.isfinite(before).all(axis=1)
    if not known.any():
        return Curves(take.times, np.full(len(take), np.nan), mended.times, np.full(len(mended), np.nan))
    centre = before[known].mean(axis=0)
    most = np.linalg.svd(before[known] - centre, full_matrices=False)[2][0]
    return Curves(take.times, (before - centre) @ most, mended.times, (after - centre) @ most)


def _shape_values(rows: NDArray[np.intp]) -> Callable[[Take], FloatArray]:
    return lambda take: take.shape[:, rows].reshape(len(take), -1).astype(np.float64)


_PART_VALUES: dict[str, Callable[[Take], FloatArray]] = {
    **{part: _shape_values(rows) for part, (rows, _) in SHAPE_PARTS.items()},
    "rotation": lambda take: take.pose[:, 1:4],
    "place": lambda take: take.pose[:, 4:6] / (np.median(take.pose[take.found, 0]) if take.found.any() else 1.0),
    "gaze": lambda take: take.gaze.astype(np.float64),
}
