"""Smoothing of takes, either as live or without delay (method.md, section 8.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FacemimeError
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from ..tracking.smoothing import ACTION, GAZE, PLACE, ROTATION, SHAPE_PARTS, smooth_all
from .take import Take
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
    "actions": 6.0,
}
"""Cutoffs in Hz by part, at which half of the amplitude passes."""
_MIN_CUTOFF = 1e-3
"""The lowest cutoff in Hz."""
_NO_CUTOFF = 1e5
"""Cutoff in Hz above which nothing is smoothed."""
_MAX_STEP = 0.25
"""Time between frames in seconds across which nothing is smoothed."""
_MIN_STEP = 1e-3
"""Smallest time between frames in seconds. Where a part was punched in, two frames may nearly coincide."""
_MIN_FRAMES = 5
"""Smallest number of frames that is smoothed."""
_OTHERS = (
    *(("gaze", GAZE, 1), ("vergence", ACTION, 0)),
    *(("actions", ACTION, 0), ("teeth", ACTION, 0), ("coefficients", ACTION, 0)),
)
"""Arrays beside shape and pose that are smoothed as live, and how."""


def smooth_take(take: Take, amount: float = 1.0) -> Take:
    """Smooth a take as `ResultSmoother` does live.

    Parameters
    ----------
    take : Take
        The take, which is returned unchanged if it was smoothed before.
    amount : float
        As for `ResultSmoother`; 0 returns the take unchanged.

    Returns
    -------
    Take
        The smoothed take.

    Examples
    --------
    >>> from facemime import load_take, smooth_take
    >>> take = load_take("performance.facetake")
    >>> calm = smooth_take(take, 0.5)
    >>> steps = [np.nanmean(abs(np.diff(one.shape, axis=0))) for one in (take, calm)]
    >>> bool(steps[1] < steps[0])
    True
    """
    if amount <= 0.0 or take.info.get("smoothed") or take.info.get("measured"):
        return take
    shape, pose, landmarks = take.shape.astype(np.float64), take.pose.copy(), take.landmarks.copy()
    for run in _unbroken(take.found):
        times = take.times[run]
        for rows, cutoffs in SHAPE_PARTS.values():
            flat = shape[run][:, rows].reshape(len(run), -1)
            shape[np.ix_(run, rows)] = smooth_all(times, flat, cutoffs.softer(amount), 3).reshape(len(run), -1, 3)
        pose[run, 1:4] = smooth_all(times, pose[run, 1:4], ROTATION.softer(amount))
        # As `ResultSmoother`: the logarithm of the scale, and positions in eye distances.
        unit = pose[run[0], 0]
        place = np.column_stack([np.log(pose[run, 0]), pose[run, 4:6] / unit])
        place = smooth_all(times, place, PLACE.softer(amount))
        pose[run, 0], pose[run, 4:6] = np.exp(place[:, 0]), place[:, 1:] * unit
    landmarks[take.found] = project(shape[take.found], pose[take.found])
    changed: dict[str, Any] = {"shape": shape.astype(np.float32), "pose": pose, "landmarks": landmarks}
    for name, cutoffs, dims in _OTHERS:
        seen = getattr(take, name).reshape(len(take), -1).astype(np.float64)
        for run in _unbroken(take.found & np.isfinite(seen).all(axis=1)):
            seen[run] = smooth_all(take.times[run], seen[run], cutoffs.softer(amount), dims)
        changed[name] = seen.astype(np.float32).reshape(getattr(take, name).shape)
    return replace(take, **changed, info={**take.info, "smoothed": "one-euro"})


def _unbroken(known: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
    """Yield the rows of each run of known frames."""
    rows = np.flatnonzero(known)
    yield from (run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(run))


def smooth_zero_phase(take: Take, cutoffs: Mapping[str, float] | None = None) -> Take:
    """Smooth a take without delay, with one cutoff in Hz per part of the face; `cutoffs` override `CUTOFFS`.

    Pose, shape, gaze, actions and teeth are smoothed, and landmarks follow. Nothing is smoothed across lost frames, and
    a part whose cutoff is `inf` is unchanged. Raises FacemimeError if a part does not exist, or a cutoff is too low.
    """
    chosen = {**CUTOFFS, **(cutoffs or {})}
    for part, cutoff in chosen.items():
        if part not in CUTOFFS or not cutoff >= _MIN_CUTOFF:
            raise FacemimeError(
                "{part}={cutoff:g} is not a cutoff. Use {min_cutoff:g} Hz or more for one of: {known}.",
                part=part,
                cutoff=cutoff,
                min_cutoff=_MIN_CUTOFF,
                known=", ".join(CUTOFFS),
            )
    shape, pose, gaze = take.shape.astype(np.float64), take.pose.copy(), take.gaze.astype(np.float64)
    for run in _runs(take.times, take.found):
        for part, (rows, _) in SHAPE_PARTS.items():
            flat = shape[run][:, rows].reshape(len(run), -1)
            shape[np.ix_(run, rows)] = low_pass(take.times[run], flat, chosen[part]).reshape(len(run), -1, 3)
        pose[run, 1:4] = low_pass(take.times[run], np.unwrap(pose[run, 1:4], axis=0), chosen["rotation"])
        # The logarithm of the scale, as distances multiply; it also keeps the scale positive.
        place = np.column_stack([np.log(pose[run, 0]), pose[run, 4:6]])
        place = low_pass(take.times[run], place, chosen["place"])
        pose[run, 0], pose[run, 4:6] = np.exp(place[:, 0]), place[:, 1:]
    for run in _runs(take.times, np.isfinite(take.gaze).all(axis=1)):
        gaze[run] = low_pass(take.times[run], gaze[run], chosen["gaze"])
    vergence, teeth = (values[:, None].astype(np.float64) for values in (take.vergence, take.teeth))
    actions, coefficients = take.actions.astype(np.float64), take.coefficients.astype(np.float64)
    parts = ((vergence, "gaze"), (actions, "actions"), (teeth, "actions"), (coefficients, "actions"))
    for values, part in parts:
        for run in _runs(take.times, np.isfinite(values).all(axis=1)):
            values[run] = low_pass(take.times[run], values[run], chosen[part])
    landmarks = take.landmarks.copy()
    landmarks[take.found] = project(shape[take.found], pose[take.found])
    changed: dict[str, Any] = {
        "shape": shape.astype(np.float32),
        "gaze": gaze.astype(np.float32),
        "vergence": vergence[:, 0].astype(np.float32),
        "actions": actions.astype(np.float32),
        "teeth": teeth[:, 0].astype(np.float32),
        "coefficients": coefficients.astype(np.float32),
        "landmarks": landmarks,
    }
    return replace(take, pose=pose, **changed, info={**take.info, "smoothed": "zero-phase"})


def _runs(times: FloatArray, known: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
    """Yield the rows of each run of known frames without a gap that is long enough to be smoothed."""
    rows = np.flatnonzero(known)
    breaks = np.flatnonzero((np.diff(rows) > 1) | (np.diff(times[rows]) > _MAX_STEP)) + 1
    yield from (run for run in np.split(rows, breaks) if len(run) >= _MIN_FRAMES)


def low_pass(times: FloatArray, values: FloatArray, cutoff: float) -> FloatArray:
    """Filter values (N, D) at increasing, not necessarily even times by a low-pass without delay.

    Minimises ``sum_i h_i |z_i - y_i|^2 + integral |z''|^2 / (2 pi f_c)^4``, where h_i is the time that a frame stands
    for (equation 8.1; Whittaker 1923; Eilers 2003). The gain ``1 / (1 + (f / f_c)^4)`` is that of a second-order
    Butterworth filter run forwards and backwards, so half of the amplitude passes at the cutoff in Hz, but there are no
    transients at the ends. Straight lines are unchanged. The system is pentadiagonal, so the cost is linear in N.
    """
    if not cutoff < _NO_CUTOFF:
        return values
    steps = np.maximum(np.diff(times), _MIN_STEP)
    share = np.convolve(steps, [0.5, 0.5])
    middle = 0.5 * (steps[1:] + steps[:-1])
    # z'' at the middle of three frames as a second difference, times the root of the time that it stands for.
    weight = np.sqrt(middle) / (middle * (2.0 * pi * cutoff) ** 2)
    first, last = weight / steps[:-1], weight / steps[1:]
    rows = np.stack([first, -(first + last), last])
    # Normal equations of 8.1 as diagonals of a pentadiagonal matrix.
    bands = np.zeros((3, len(times)))
    bands[0] = share
    for i in range(3):
        bands[0, i : i + len(middle)] += rows[i] ** 2
        for j in range(i + 1, 3):
            bands[j - i, i : i + len(middle)] += rows[i] * rows[j]
    return np.asarray(linalg.solveh_banded(bands, share[:, None] * values, lower=True))


@dataclass(frozen=True)
class Curves:
    """Motion of a part before and after mending, as one number per frame: eye distances, or radians for rotations.

    Attributes
    ----------
    times, before : (N,) float64
        Times in seconds, and values before mending.
    mended_times, after : (M,) float64
        The same after mending.
    """

    times: FloatArray
    before: FloatArray
    mended_times: FloatArray
    after: FloatArray


def before_after(take: Take, mended: Take, part: str) -> Curves:
    """Project the motion of a part in `CUTOFFS` onto its largest direction before mending; NaN where unknown."""
    before, after = _PART_VALUES[part](take), _PART_VALUES[part](mended)
    known = np.isfinite(before).all(axis=1)
    if not known.any():
        return Curves(take.times, np.full(len(take), np.nan), mended.times, np.full(len(mended), np.nan))
    # First principal component of the motion before mending, onto which both are projected.
    centre = before[known].mean(axis=0)
    most = linalg.svd(before[known] - centre, full_matrices=False)[2][0]
    return Curves(take.times, (before - centre) @ most, mended.times, (after - centre) @ most)


def _shape_values(rows: NDArray[np.intp]) -> Callable[[Take], FloatArray]:
    return lambda take: take.shape[:, rows].reshape(len(take), -1).astype(np.float64)


_PART_VALUES: dict[str, Callable[[Take], FloatArray]] = {
    **{part: _shape_values(rows) for part, (rows, _) in SHAPE_PARTS.items()},
    "rotation": lambda take: take.pose[:, 1:4],
    "place": lambda take: take.pose[:, 4:6] / (np.median(take.pose[take.found, 0]) if take.found.any() else 1.0),
    "gaze": lambda take: take.gaze.astype(np.float64),
    "actions": lambda take: take.actions.astype(np.float64),
}
