"""Corrections of tracked landmarks by pins: in the frames around them, and in alike frames of the same performer
(method.md, section 8.6).

The error of the tracker is a Gaussian process over frames and landmarks, for each part of the face by itself. Its
covariance is the product of one over frames, which are near in time or look alike, and one over landmarks, which move
together in expressions (Rasmussen & Williams 2006).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ..face.landmarks import (
    LOWER_LIDS,
    LOWER_LIPS,
    N_LANDMARKS,
    UPPER_LIDS,
    UPPER_LIPS,
    lid_gaps,
    lip_gaps,
)
from ..face.rotation import euler_to_matrix
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .face_space import load_face_space
from .learnt import PARTS, Learnt, Looks
from .pins import LEARN, PINS, frames_of_pins, learns_from_pins, pins_of
from .take import Take
from .timing import project

_ACTIVATION = 0.3
"""Standard deviation of the error of an expression's activation."""
_OWN = 0.03
"""Standard deviation of the error of landmarks that no expression explains, in eye distances."""
_OWN_REACH = (0.15, 0.05)
"""Distances across and down over which neighbouring landmarks share it, in eye distances: lids and lips that face each
other err by themselves."""
_REACH = 0.5
"""Distance over which landmarks share the error of an expression, in eye distances."""
_DEPTH = 0.5
"""Errors in depth, relative to those across."""
_PIN = 0.003
"""Standard deviation of a pin, in eye distances."""
_TIME = 0.12
"""Seconds over which a correction lasts."""
_LOOK = 1.5
"""Difference of landmarks over which a correction fades, relative to how much their part moves in the take."""
_LIKENESS = (0.5, 1.0, 2.0)
"""Differences, as `_LOOK`, of which learning chooses the one by which pins predict each other best."""
_STILL = 0.005
"""Motion of a part below which none is assumed, in eye distances."""
_LEARNT = 0.9
"""Share of the variance of the errors that recurs in alike frames."""
_HELPS = 0.7
"""Share of the squared residuals of pins, predicted by the others, above which nothing is learnt."""
_FOLDS = 12
"""Largest number of groups into which pins are divided to predict each other."""


@dataclass(frozen=True)
class _Pins:
    """Pins of one part, (P,): frames, landmarks, their axes in the image (P, 2, 3), residuals (P, 2)."""

    part: int
    frames: IntArray
    landmarks: IntArray
    axes: FloatArray
    residuals: FloatArray

    def chosen(self, which: IntArray) -> _Pins:
        """Return some of them."""
        return _Pins(self.part, self.frames[which], self.landmarks[which], self.axes[which], self.residuals[which])

    def moved(self, kernel: FloatArray) -> FloatArray:
        """Solve for what each pin adds to the landmarks of its part, (P, n, 3), for the kernel over frames (P, P)."""
        cov, count = covariance(), len(self.frames)
        across = cov[self.landmarks][:, :, self.landmarks]
        seen = np.einsum("pai,piqj,qbj->paqb", self.axes, across, self.axes, optimize=True)
        matrix = (kernel[:, None, :, None] * seen).reshape(2 * count, 2 * count)
        matrix[np.diag_indices(2 * count)] += _PIN**2
        weights = linalg.solve_definite(matrix, self.residuals.reshape(-1)).reshape(count, 2)
        pulled = np.einsum("pa,paj->pj", weights, self.axes)
        return np.asarray(np.einsum("nipj,pj->pni", cov[PARTS[self.part]][:, :, self.landmarks], pulled))


@dataclass(frozen=True)
class _Slit:
    """Lids or lips that face each other: landmarks (n,), and their gaps.

    `most` is the opening that is nearly shut, as a share of the usual one or, if `absolute`, in eye distances.
    """

    upper: IntArray
    lower: IntArray
    measure: Callable[[FloatArray], FloatArray]
    columns: slice
    most: float
    absolute: bool = False

    def gaps(self, shapes: FloatArray) -> FloatArray:
        """Gaps of shapes (N, 66, 3), (N, n)."""
        return np.asarray(self.measure(shapes)[:, self.columns])

    def most_of(self, gaps: FloatArray) -> float:
        """Mean gap below which pins mean shut, for the usual gaps (N, n)."""
        return self.most if self.absolute else self.most * float(np.median(gaps.mean(axis=1)))


_SLITS = (
    _Slit(UPPER_LIDS[:2], LOWER_LIDS[:2], lid_gaps, slice(0, 2), 0.2),
    _Slit(UPPER_LIDS[2:], LOWER_LIDS[2:], lid_gaps, slice(2, 4), 0.2),
    _Slit(UPPER_LIPS, LOWER_LIPS, lip_gaps, slice(0, 3), 0.015, absolute=True),
)


@lru_cache(maxsize=1)
def covariance() -> FloatArray:
    """Covariance of the errors of landmarks, (66, 3, 66, 3), in squared eye distances."""
    space = load_face_space()
    apart = space.mean[:, None, :2] - space.mean[None, :, :2]
    units = _ACTIVATION * space.units.reshape(len(space.units), -1)
    shared = (units.T @ units).reshape(N_LANDMARKS, 3, N_LANDMARKS, 3)
    own = _OWN**2 * np.exp(-0.5 * np.square(apart / _OWN_REACH).sum(axis=2))
    depth = np.diag([1.0, 1.0, _DEPTH**2])
    near = np.exp(-0.5 * np.square(apart / _REACH).sum(axis=2))
    return np.asarray(shared * near[:, None, :, None] + own[:, None, :, None] * depth[None, :, None])


def solve_pins(take: Take) -> Take:
    """Solve a take around its pins, and in alike frames if ``info["learn_pins"]`` is set.

    Pins at times without a face are kept for when the gap is filled. The take itself is returned if nothing changes.
    """
    return _Solution(take).take() if pins_of(take) and take.found.any() else take


def learn(take: Take) -> tuple[Learnt, ...]:
    """Learn from the pins of a take, as it was tracked, what corrects alike frames of this performer.

    For each part, as many pins as there are predict those of one frame from those of the others; without a benefit
    there, the part is left out.
    """
    return tuple(part.learnt for part in _Solution(take).parts if part.learnt is not None) if pins_of(take) else ()


def without_pins(take: Take) -> Take:
    """Solve a take and drop its pins, so that the result is that of any other take."""
    solved = solve_pins(take)
    return replace(solved, info={key: value for key, value in take.info.items() if key not in (PINS, LEARN)})


class _Solution:
    """The solution of a take, part by part."""

    def __init__(self, take: Take) -> None:
        self._take = take
        self._found = np.flatnonzero(take.found)
        self._shapes = take.shape[self._found].astype(np.float64)
        self._poses = take.pose[self._found]
        self._times = take.times[self._found]
        self.parts = [_Part(pins, self._times, self._shapes, self._poses) for pins in self._pins()]

    def take(self) -> Take:
        """Return the solved take."""
        learns = learns_from_pins(self._take)
        shape, landmarks = self._take.shape.copy(), self._take.landmarks.copy()
        shapes = self._shapes.copy()
        for part in self.parts:
            part.correct(shapes, learns=learns)
        moved = np.flatnonzero((shapes != self._shapes).any(axis=(1, 2)))
        frames = self._found[moved]
        shape[frames] = shapes[moved]
        # What was seen beside the shape model, such as lips held behind a hand, keeps its distance.
        landmarks[frames] += project(shapes[moved], self._poses[moved]) - project(
            self._shapes[moved], self._poses[moved]
        )
        return replace(self._take, shape=shape, landmarks=landmarks)

    def _pins(self) -> Iterator[_Pins]:
        pins = pins_of(self._take)
        times, landmarks = np.array([pin.time for pin in pins]), np.array([pin.landmark for pin in pins])
        rows, seen = frames_of_pins(self._take, times)
        axes = np.array([euler_to_matrix(*angles)[:2] for angles in self._poses[rows, 1:4]])
        tracked = self._take.landmarks[self._found[rows], landmarks].astype(np.float64)
        away = (np.array([(pin.x, pin.y) for pin in pins]) - tracked) / self._poses[rows, :1]
        for number, part in enumerate(PARTS):
            mine = np.flatnonzero(seen & np.isin(landmarks, part))
            if len(mine):
                yield _Pins(number, rows[mine], landmarks[mine], axes[mine], away[mine])


class _Part:
    """The solution of one part."""

    def __init__(self, pins: _Pins, times: FloatArray, shapes: FloatArray, poses: FloatArray) -> None:
        self._pins, self._times = pins, times
        self._looks = Looks.of(shapes, poses, PARTS[pins.part])
        self._motion = max(float(np.sqrt(self._looks.landmarks.var(axis=0).sum())), _STILL)
        self._lasting = self._near(np.arange(len(times)), pins.frames)
        self.learnt = self._learn()

    def _near(self, frames: IntArray, pinned: IntArray) -> FloatArray:
        """Share of a correction in frames `pinned` (P,) that frames (N,) near in time keep, (N, P)."""
        apart = (self._times[frames, None] - self._times[pinned]) / _TIME
        return np.asarray(np.exp(-0.5 * np.square(apart)) * self._alike(frames, pinned, _LOOK * self._motion))

    def _alike(self, frames: IntArray, pinned: IntArray, look: float) -> FloatArray:
        return self._looks.part(frames).likeness(self._looks.part(pinned), look)

    def _kernel(self, frames: IntArray, pinned: IntArray, look: float) -> FloatArray:
        """Share of a correction in frames `pinned` (P,) that frames (N,) which are near or alike have, (N, P)."""
        return np.asarray(_LEARNT * self._alike(frames, pinned, look) + (1.0 - _LEARNT) * self._near(frames, pinned))

    def correct(self, shapes: FloatArray, *, learns: bool) -> None:
        """Correct shapes (N, 66, 3) in place."""
        pins, part = self._pins, PARTS[self._pins.part]
        near = self._lasting
        if learns and self.learnt is not None:
            near = self._kernel(np.arange(len(self._times)), pins.frames, self.learnt.look)
        tracked = shapes.copy()
        shapes[:, part] += np.tensordot(near, pins.moved(near[pins.frames]), 1)
        self._close(shapes, tracked)

    def _close(self, shapes: FloatArray, tracked: FloatArray) -> None:
        """Close the lids or lips that pins have all but closed, for as long as the correction lasts.

        A lid that is dragged to the other one shuts the eye, even if it has taken that one along.
        """
        pins = self._pins
        for slit in _SLITS:
            upper, lower = (np.isin(pins.landmarks, side) for side in (slit.upper, slit.lower))
            dragged = tracked.copy()
            for side, pinned in ((slit.upper, upper), (slit.lower, lower)):
                if pinned.any():
                    dragged[:, side] = shapes[:, side]
            gaps, most = slit.gaps(shapes), slit.most_of(slit.gaps(tracked))
            least = np.minimum(gaps.mean(axis=1), slit.gaps(dragged).mean(axis=1))
            shut = (upper | lower) & (least[pins.frames] < most)
            if shut.any():
                closing = self._lasting[:, shut].max(axis=1)[:, None] * gaps
                share = float(lower[shut].sum() / shut.sum())  # what is pinned stays
                shapes[:, slit.upper, 1] += share * closing
                shapes[:, slit.lower, 1] -= (1.0 - share) * closing

    def _learn(self) -> Learnt | None:
        """Return what the pins of this part tell about alike frames; None if they do not predict each other."""
        pins = self._pins
        frames = np.unique(pins.frames)
        folds = np.searchsorted(frames, pins.frames) % _FOLDS
        if len(frames) < 2:
            return None
        looks = [share * self._motion for share in _LIKENESS]
        wrong = [self._wrong(folds, look) for look in looks]
        look = looks[int(np.argmin(wrong))]
        if min(wrong) > _HELPS * float(np.square(pins.residuals).sum()):
            return None
        moved = _LEARNT * pins.moved(self._kernel(pins.frames, pins.frames, look))
        at = [moved[pins.frames == frame].sum(axis=0) for frame in frames]
        return Learnt(pins.part, self._looks.part(frames), look, np.array(at))

    def _places(self, landmarks: IntArray) -> IntArray:
        """Positions of `landmarks` (P,) in the part."""
        return np.array([np.flatnonzero(PARTS[self._pins.part] == landmark)[0] for landmark in landmarks])

    def _wrong(self, folds: IntArray, look: float) -> float:
        """Sum of squares that remains of the residuals of pins if others predict them."""
        pins, wrong = self._pins, 0.0
        for fold in np.unique(folds):
            kept, left = pins.chosen(np.flatnonzero(folds != fold)), pins.chosen(np.flatnonzero(folds == fold))
            moved = kept.moved(self._kernel(kept.frames, kept.frames, look))
            alike = _LEARNT * self._alike(left.frames, kept.frames, look)
            told = np.einsum("lp,plj->lj", alike, moved[:, self._places(left.landmarks)])
            wrong += float(np.square(np.einsum("laj,lj->la", left.axes, told) - left.residuals).sum())
        return wrong
