"""Smoothing of live results by a one-euro filter for each part of the face (method.md, section 3.10).

The cutoff of this low-pass filter rises with speed (Casiez, Roussel & Vogel 2012): what is at rest is held still, and
fast motion passes. Each part has its own cutoffs and a single speed, so that its landmarks stay together, and a blink
passes while the brow above it is held.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, JAW, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, MOUTH_OUTER, NOSE
from ..face.rotation import euler_to_matrix
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from .result import TrackResult


@dataclass(frozen=True)
class Cutoffs:
    """Cutoff frequencies of one part of the face.

    Attributes
    ----------
    at_rest : float
        Cutoff in Hz at rest (`f_0`; `f_cmin` in the paper).
    by_speed : float
        Rise of the cutoff with speed (`beta`), in Hz per unit per second; the unit is an outer-eye distance or a
        radian.
    speed : float
        Cutoff in Hz for the speed itself (`f_d`).
    """

    at_rest: float
    by_speed: float
    speed: float

    def softer(self, amount: float) -> Cutoffs:
        """Return cutoffs with those at rest and by speed divided by `amount`, which has to be positive."""
        return replace(self, at_rest=self.at_rest / amount, by_speed=self.by_speed / amount)


SHAPE_PARTS: dict[str, tuple[NDArray[np.intp], Cutoffs]] = {
    "brows": (BROWS, Cutoffs(1.0, 25.0, 3.0)),
    "right eye": (EYE_RIGHT, Cutoffs(1.0, 120.0, 8.0)),
    "left eye": (EYE_LEFT, Cutoffs(1.0, 120.0, 8.0)),
    "nose": (NOSE, Cutoffs(0.8, 15.0, 3.0)),
    "mouth": (np.concatenate([MOUTH_OUTER, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER]), Cutoffs(1.2, 60.0, 8.0)),
    "jaw": (JAW, Cutoffs(1.0, 30.0, 5.0)),
}
"""Landmarks and cutoffs of the parts of the shape; every landmark belongs to one part."""
ROTATION = Cutoffs(1.5, 30.0, 4.0)
PLACE = Cutoffs(1.5, 60.0, 4.0)
GAZE = Cutoffs(1.5, 8.0, 8.0)
ACTION = Cutoffs(1.0, 6.0, 4.0)
"""Cutoffs of the vergence of the eyes, in radians, of the actions, of teeth and of stated coefficients, each filtered
by itself."""


class OneEuroFilter:
    """One-euro filter for a vector (D,) that is sampled at increasing times (equation 3.8).

    Its components share one cutoff, unless `dims` is 0, which gives each its own. With
    ``a(f) = 1 / (1 + 1 / (2 pi f dt))``::

        v <- v + a(f_d) (dy / dt - v)
        x <- x + a(f_0 + beta |v|) (y - x)

    where `|v|` is the root mean square speed over points of `dims` components each. The first value passes unchanged.
    """

    def __init__(self, cutoffs: Cutoffs, dims: int = 1) -> None:
        self.cutoffs, self._dims = cutoffs, dims
        self.reset()

    def reset(self) -> None:
        """Forget past values, so that the next value passes unchanged."""
        self._time = -np.inf
        self._seen: FloatArray | None = None
        self._value: FloatArray | None = None
        self._velocity: FloatArray | None = None

    def __call__(self, seen: FloatArray, time: float) -> FloatArray:
        """Return the smoothed vector for the sample `seen` at `time` in seconds."""
        if self._seen is None or self._value is None or self._velocity is None:
            self._velocity, self._value = np.zeros_like(seen), seen
        elif time > self._time:
            # Speed, itself smoothed, then the cutoff that it allows: the two lines of the equation above.
            step = time - self._time
            towards = _share(self.cutoffs.speed, step)
            self._velocity = self._velocity + towards * ((seen - self._seen) / step - self._velocity)
            speed = np.abs(self._velocity)
            if self._dims:
                speed = np.sqrt(np.square(speed).mean() * self._dims)
            share = _share(self.cutoffs.at_rest + self.cutoffs.by_speed * speed, step)
            self._value = self._value + share * (seen - self._value)
        self._seen, self._time = seen, time
        return self._value


def smooth_all(times: FloatArray, seen: FloatArray, cutoffs: Cutoffs, dims: int = 1) -> FloatArray:
    """Smooth vectors (N, D) at increasing `times` (N,) as a new `OneEuroFilter` does one after the other."""
    steps = np.diff(times)[:, None]
    towards, moved = np.asarray(_share(cutoffs.speed, steps)), np.zeros_like(seen)
    moved[1:] = towards * np.diff(seen, axis=0) / steps
    speed = np.abs(_recursion(towards, moved)[1:])
    if dims:
        speed = np.sqrt(np.square(speed).mean(axis=1, keepdims=True) * dims)
    share, values = np.asarray(_share(cutoffs.at_rest + cutoffs.by_speed * speed, steps)), seen.copy()
    values[1:] *= share
    return _recursion(share, values)


def _recursion(shares: FloatArray, added: FloatArray) -> FloatArray:
    """Solve ``x_i = (1 - shares_i) x_(i-1) + added_i`` from ``x_0 = added_0``: (N, D) for shares (N - 1, D or 1)."""
    if len(added) < 2:
        return added
    if shares.shape[1] > 1:
        columns = zip(shares.T[..., None], added.T[..., None], strict=True)
        return np.column_stack([_recursion(*column) for column in columns])
    bands = np.ones((2, len(added)))
    bands[1, :-1] = shares[:, 0] - 1.0
    return np.asarray(linalg.solve_banded((1, 0), bands, added))


def _share(cutoff: FloatArray | float, step: FloatArray | float) -> FloatArray | float:
    return 1.0 / (1.0 + 1.0 / (2.0 * pi * cutoff * step))


class ResultSmoother:
    """Smooths the results of one performance, frame by frame.

    Pose, shape, gaze, actions, teeth and coefficients are smoothed, and landmarks follow from pose and shape. Shape
    parameters, pupils and confidences remain as tracked. When tracking is lost the filters are reset, so that nothing
    is smoothed across the gap.

    Parameters
    ----------
    amount : float
        Amount of smoothing: 1 is the tuned amount, 2 halves the cutoffs, which doubles the delay, and near 0 all
        passes.
    """

    def __init__(self, amount: float = 1.0) -> None:
        self.amount = amount
        self._shape = [(rows, OneEuroFilter(cutoffs.softer(amount), 3)) for rows, cutoffs in SHAPE_PARTS.values()]
        self._rotation, self._place, self._gaze = (OneEuroFilter(c.softer(amount)) for c in (ROTATION, PLACE, GAZE))
        each = (OneEuroFilter(ACTION.softer(amount), dims=0) for _ in range(4))
        self._vergence, self._actions, self._teeth, self._coefficients = each
        self._unit = 0.0

    def reset(self) -> None:
        """Forget past results."""
        others = (self._vergence, self._actions, self._teeth, self._coefficients)
        for each in (self._rotation, self._place, self._gaze, *others, *(part for _, part in self._shape)):
            each.reset()
        self._unit = 0.0

    def smooth(self, result: TrackResult, time: float) -> TrackResult:
        """Return `result` smoothed, or itself if there is no face; `time`, in seconds, has to increase from call to
        call.
        """
        if not result.found:
            self.reset()
            return result
        shape = result.shape.copy()
        for rows, part in self._shape:
            shape[rows] = part(result.shape[rows].ravel(), time).reshape(-1, 3)
        pose = self._smooth_pose(result.pose, time)
        return replace(
            result,
            landmarks=pose[0] * shape @ euler_to_matrix(*pose[1:4])[:2].T + pose[4:6],
            pose=pose,
            shape=shape,
            gaze=_smoothed(self._gaze, result.gaze, time),
            vergence=float(_smoothed(self._vergence, np.array([result.vergence]), time)[0]),
            actions=_smoothed(self._actions, result.actions, time),
            teeth=float(_smoothed(self._teeth, np.array([result.teeth]), time)[0]),
            coefficients=_smoothed(self._coefficients, result.coefficients, time),
        )

    def _smooth_pose(self, pose: FloatArray, time: float) -> FloatArray:
        """Smooth the logarithm of the scale, and positions in eye distances, so that speeds are comparable."""
        self._unit = self._unit or float(pose[0])
        rotation = self._rotation(pose[1:4], time)
        size, x, y = self._place(np.array([np.log(pose[0]), pose[4] / self._unit, pose[5] / self._unit]), time)
        return np.array([np.exp(size), *rotation, x * self._unit, y * self._unit])


def _smoothed(low_pass: OneEuroFilter, seen: FloatArray, time: float) -> FloatArray:
    """Return the smoothed value. An unknown value is returned as it is, and the filter restarts after it."""
    if not np.isfinite(seen).all():
        low_pass.reset()
        return seen
    return low_pass(seen, time)
