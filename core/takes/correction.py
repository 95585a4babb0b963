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
    CHIN,
    LOWER_LIDS,
    LOWER_LIPS,
    N_LANDMARKS,
    UPPER_LIDS,
    UPPER_LIPS,
    lid_gaps,
    lip_gaps,
)
from ..face.rotation import euler_to_matrices
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .face_space import load_face_space
from .learnt import PARTS, Faces, Learnt, Likeness, Looks
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
_FAINT = 1e-6
"""Share of a correction below which a frame stays exactly as it was tracked."""
_CHIN_MOVED = 0.01
"""Motion of the chin, in eye distances, beyond which a correction opens or shuts the jaw."""
_LOOK = 1.5
"""Difference of landmarks over which a correction fades, relative to how much their part moves in the take."""
_ALIKE = (0.6, 3.0)
"""Differences, as `_LOOK`, over which what recurs fades: half changes with the expression, half lasts through most.
Chosen on half A of the rendered clips (tracking.md, *Pins*), where 4 is slightly better than 3; but on half B, 4 lets
blinks make an eye worse by 6 %."""
_STILL = 0.005
"""Motion of a part below which none is assumed, in eye distances."""
_LEARNT = 0.95
"""Share of the variance of the errors that recurs in alike frames; chosen on half A."""
_HELPS = 0.9
"""Share of the squared residuals of pins, predicted by those of other frames, above which nothing is learnt;
chosen on half A. With 0.5, learning is off for some parts that it would help."""
_UNSURE = 3.0
"""Difference of a part's certainty over which a correction fades, relative to the usual one from its median in the
take; chosen on half A. Larger ones let missed blinks close open eyes."""
_STEADY = 0.004
"""Usual difference of a part's certainty below which none is assumed; chosen on half A."""
_FARTHEST = 3.0
"""Distance from the tracked landmark, in eye distances, above which a pin is on something else, and ignored."""
_ROWS = 4096
"""Frames that are corrected at once."""


@dataclass(frozen=True)
class _Pins:
    """Pins of one part in F frames.

    `frames` (F,); of P pins the place of their frame (P,), their landmarks (P,), and in the image their covariance with
    the part (2 P, 3 n), with each other (2 P, 2 P), and their residuals (2 P,).
    """

    part: int
    frames: IntArray
    places: IntArray
    landmarks: IntArray
    across: FloatArray
    seen: FloatArray
    residuals: FloatArray

    @classmethod
    def of(cls, part: int, rows: IntArray, landmarks: IntArray, axes: FloatArray, away: FloatArray) -> _Pins:
        """Describe pins, (P,): frames, landmarks, the axes of the image (P, 2, 3), residuals (P, 2)."""
        frames, places = np.unique(rows, return_inverse=True)
        size, own = 3 * len(PARTS[part]), landmarks - PARTS[part][0]
        design = np.zeros((len(rows), 2, len(PARTS[part]), 3))
        design[np.arange(len(rows)), :, own] = axes
        design = design.reshape(-1, size)
        across = linalg.multiply(design, covariance()[PARTS[part]][:, :, PARTS[part]].reshape(size, size))
        return cls(part, frames, places, landmarks, across, linalg.multiply(across, design.T), away.reshape(-1))

    def matrix(self, kernel: FloatArray) -> FloatArray:
        """Covariance of the residuals, (2 P, 2 P), for the kernel over frames (F, F)."""
        places = np.repeat(self.places, 2)
        matrix = kernel[np.ix_(places, places)] * self.seen
        matrix[np.diag_indices(len(matrix))] += _PIN**2
        return np.asarray(matrix)

    def moved(self, kernel: FloatArray) -> FloatArray:
        """Solve for what each frame adds to the landmarks of the part, (F, n, 3), for the kernel over frames (F, F)."""
        weights = linalg.solve_definite(self.matrix(kernel), self.residuals)
        moved = np.zeros((len(self.frames), self.across.shape[1]))
        np.add.at(moved, np.repeat(self.places, 2), weights[:, None] * self.across)
        return moved.reshape(len(moved), -1, 3)

    def wrong(self, kernel: FloatArray) -> float:
        """Sum of squares that remains of the residuals of each frame if the other frames predict them.

        From the inverse of the covariance (Rasmussen & Williams 2006, section 5.4.2).
        """
        inverse = linalg.inverse_definite(self.matrix(kernel))
        weights, places, wrong = linalg.multiply(inverse, self.residuals), np.repeat(self.places, 2), 0.0
        for place in range(len(self.frames)):
            mine = np.flatnonzero(places == place)
            wrong += float(np.square(linalg.solve_definite(inverse[np.ix_(mine, mine)], weights[mine])).sum())
        return wrong


@dataclass(frozen=True)
class _Slit:
    """Lids or lips that face each other: landmarks (n,), their gaps, and when they are nearly shut.

    That is an opening below `most`, a share of the usual one, or below `least`, in eye distances.
    """

    upper: IntArray
    lower: IntArray
    measure: Callable[[FloatArray], FloatArray]
    columns: slice
    most: float
    least: float

    def gaps(self, shapes: FloatArray) -> FloatArray:
        """Gaps of shapes (N, 66, 3), (N, n)."""
        return np.asarray(self.measure(shapes)[:, self.columns])

    def nearly_shut(self, gaps: FloatArray) -> float:
        """Mean gap below which pins mean shut, for the usual gaps (N, n)."""
        return max(self.most * float(np.median(gaps.mean(axis=1))), self.least)


_SLITS = (
    _Slit(UPPER_LIDS[:2], LOWER_LIDS[:2], lid_gaps, slice(0, 2), 0.2, 0.01),
    _Slit(UPPER_LIDS[2:], LOWER_LIDS[2:], lid_gaps, slice(2, 4), 0.2, 0.01),
    _Slit(UPPER_LIPS, LOWER_LIPS, lip_gaps, slice(0, 3), 0.0, 0.015),
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

    For each part, the pins of each frame are predicted from those of the others; without a benefit there, the part is
    left out.
    """
    return tuple(one for part in _Solution(take).parts for one in part.learnt) if pins_of(take) else ()


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
        faces = Faces.of(self._shapes, self._poses, take.landmark_confidence[self._found])
        times = take.times[self._found]
        self.parts = [_Part(pins, times, faces) for pins in self._pins()]

    def take(self) -> Take:
        """Return the solved take."""
        learns = learns_from_pins(self._take)
        shape, landmarks = self._take.shape.copy(), self._take.landmarks.copy()
        shapes = self._shapes.copy()
        for part in self.parts:
            part.correct(shapes, learns=learns)
        moved = np.flatnonzero((shapes != self._shapes).any(axis=(1, 2)))
        frames, poses = self._found[moved], self._poses[moved]
        shape[frames] = shapes[moved]
        # What was seen beside the shape model, such as lips held behind a hand, keeps its distance.
        landmarks[frames] += project(shapes[moved] - self._shapes[moved], poses) - poses[:, None, 4:6]
        # Who moves the chin sees better whether the jaw is open than the tracker, which looks for teeth.
        teeth = self._take.teeth.copy()
        teeth[self._found[np.abs(shapes - self._shapes)[:, CHIN, 1].max(axis=1) > _CHIN_MOVED]] = np.nan
        return replace(self._take, shape=shape, landmarks=landmarks, teeth=teeth)

    def _pins(self) -> Iterator[_Pins]:
        pins = pins_of(self._take)
        times, landmarks = np.array([pin.time for pin in pins]), np.array([pin.landmark for pin in pins])
        rows, seen = frames_of_pins(self._take, times)
        axes = euler_to_matrices(self._poses[rows, 1:4])[:, :2]
        tracked = self._take.landmarks[self._found[rows], landmarks].astype(np.float64)
        away = (np.array([(pin.x, pin.y) for pin in pins]) - tracked) / self._poses[rows, :1]
        seen &= np.abs(away).max(axis=1) < _FARTHEST
        for number, part in enumerate(PARTS):
            mine = np.flatnonzero(seen & np.isin(landmarks, part))
            if len(mine):
                yield _Pins.of(number, rows[mine], landmarks[mine], axes[mine], away[mine])


class _Part:
    """The solution of one part."""

    def __init__(self, pins: _Pins, times: FloatArray, faces: Faces) -> None:
        self._pins, self._times, self._faces = pins, times, faces
        everywhere = faces.looks(pins.part, np.arange(len(times)), 1.0, 1.0)
        motion = np.sqrt(everywhere.values[:, :-2].var(axis=0).sum() / len(PARTS[pins.part]))
        self._motion = max(float(motion), _STILL)
        self._unsure = _UNSURE * max(_usual_difference(everywhere.certainty), _STEADY)
        self._usual = Likeness([self._looks(_LOOK)])
        self._looks_alike = [self._looks(look) for look in _ALIKE]
        self._alike = [Likeness([looks]) for looks in self._looks_alike]
        self.learnt = self._learn()

    def _looks(self, look: float) -> Looks:
        return self._faces.looks(self._pins.part, self._pins.frames, look * self._motion, self._unsure)

    def _near(self, frames: IntArray | slice) -> FloatArray:
        """Share of the corrections that frames (N,) near in time keep, (N, F)."""
        apart = (self._times[frames, None] - self._times[self._pins.frames]) / _TIME
        near = np.exp(-0.5 * np.square(apart)) * self._usual.of(self._faces.chosen(frames))
        near[near < _FAINT] = 0.0
        return np.asarray(near)

    def _recurring(self, frames: IntArray | slice) -> FloatArray:
        """Share of the corrections that recurs in alike frames (N,), (N, F)."""
        faces = self._faces.chosen(frames)
        return np.asarray(_LEARNT * np.mean([alike.of(faces) for alike in self._alike], axis=0))

    def _kernel(self, frames: IntArray | slice, *, learns: bool) -> FloatArray:
        """Share of the corrections that frames (N,) have which are near or, if it learns, alike, (N, F)."""
        near = self._near(frames)
        return self._recurring(frames) + (1.0 - _LEARNT) * near if learns else near

    def correct(self, shapes: FloatArray, *, learns: bool) -> None:
        """Correct shapes (N, 66, 3) in place."""
        learns = learns and bool(self.learnt)
        moved, tracked = self._pins.moved(self._kernel(self._pins.frames, learns=learns)), shapes.copy()
        for rows in self._rows():
            shapes[rows, PARTS[self._pins.part]] += np.tensordot(self._kernel(rows, learns=learns), moved, 1)
        for slit in _SLITS:
            if slit.upper[0] in PARTS[self._pins.part]:
                self._close(slit, shapes, tracked)

    def _rows(self) -> Iterator[slice]:
        """Divide the frames, so that an hour with a thousand frames with pins needs little memory."""
        return (slice(start, start + _ROWS) for start in range(0, len(self._times), _ROWS))

    def _close(self, slit: _Slit, shapes: FloatArray, tracked: FloatArray) -> None:
        """Close lids or lips that pins have all but closed, for as long as the correction lasts.

        A lid that is dragged to the other one shuts the eye, even if it has taken that one along.
        """
        pins, gaps = self._pins, slit.gaps(shapes)
        upper, lower = (np.isin(pins.landmarks, side) for side in (slit.upper, slit.lower))
        dragged = tracked[pins.frames]
        for side, pinned in ((slit.upper, upper), (slit.lower, lower)):
            mine = np.unique(pins.places[pinned])
            dragged[mine[:, None], side] = shapes[pins.frames[mine][:, None], side]
        least = np.minimum(gaps[pins.frames].mean(axis=1), slit.gaps(dragged).mean(axis=1))[pins.places]
        shut = (upper | lower) & (least < slit.nearly_shut(slit.gaps(tracked)))
        if not shut.any():
            return
        share = float(lower[shut].sum() / shut.sum())  # what is pinned stays
        for rows in self._rows():
            closing = self._near(rows)[:, np.unique(pins.places[shut])].max(axis=1)[:, None] * gaps[rows]
            shapes[rows, slit.upper, 1] += share * closing
            shapes[rows, slit.lower, 1] -= (1.0 - share) * closing

    def _learn(self) -> tuple[Learnt, ...]:
        """Return what the pins of this part tell about alike frames; nothing if they do not predict each other."""
        pins = self._pins
        if len(pins.frames) < 2:
            return ()
        # Between pins, only alike frames tell of each other, not those near in time.
        alone = self._recurring(pins.frames) + (1.0 - _LEARNT) * np.eye(len(pins.frames))
        if pins.wrong(alone) > _HELPS * float(np.square(pins.residuals).sum()):
            return ()
        moved = _LEARNT / len(self._alike) * pins.moved(self._kernel(pins.frames, learns=True))
        return tuple(Learnt(looks, moved) for looks in self._looks_alike)


def _usual_difference(certainty: FloatArray) -> float:
    """Median difference of certainties (N,) from their median; 0 if all are unknown."""
    known = certainty[~np.isnan(certainty)]
    return float(np.median(np.abs(known - np.median(known)))) if len(known) else 0.0
