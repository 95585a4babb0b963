"""Learning the performer during a session: the neutral face, and where the eyes are shut (method.md, 4.1).

The performer is not asked for anything. The first second seldom shows a face at rest, and hardly ever a blink, but a
longer performance shows both.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from math import exp, inf, nan

import numpy as np

from ..face.landmarks import eye_apertures
from ..face.rotation import euler_to_matrix, matrix_to_euler
from ..numeric.arrays import FloatArray
from ..takes.face_space import load_face_space
from ..takes.neutral import Neutral, rest_of
from ..takes.rest import MAX_SHUT, trust
from ..takes.take import TakeRecorder
from ..tracking.result import TrackResult

_FRAMES = 150
"""Largest number of frames that are searched for a neutral face. Whenever there are more, every second earlier frame is
left out, so that the rest is spread over the whole performance."""
_RATE = 15.0
"""Frames per second that are searched at first."""
_MIN_FRAMES = 30
"""Smallest number of frames that are searched."""
_SWEEPS = 2
"""Sweeps of equation 4.1 per new frame; 300 sweeps solve the equation."""
_AT_FIRST = 4
"""Sweeps per new frame until a first face at rest is found."""
_ENOUGH = 4.0
"""Seconds of a face after which the result counts in full."""
_STEP = 0.2
"""Seconds between two steps towards the result."""
_TIME = 1.5
"""Time constant of the approach to the result in seconds."""
_UNCHANGED = 2e-3
"""Distance in eye distances that landmarks of the neutral face have to be off to be moved."""
_REOPENED = 0.6
"""Opening of the eyes, relative to the neutral one, above which a blink is over."""
_BLINKS = 64
"""Number of blinks that are remembered."""
_BLINK_FRAMES = 2
"""Smallest number of frames of a blink; a misplaced lid lasts one frame."""
_LEFT = 10.0
"""Seconds without a face after which the performer may have changed."""


class PerformerLearner:
    """Improves the neutral face of a live performance, slowly, as more of the performer is seen.

    A calibrated neutral face keeps its shape; only where its eyes are shut is learnt. `neutral` is another object if it
    has changed.
    """

    def __init__(self, neutral: Neutral) -> None:
        self.neutral = neutral
        self._shut = neutral.shut
        self._rest, self._blinks = _Rest(), _Blinks()
        self._last = self._moved = -inf
        self._seen = 0.0

    @property
    def is_sure(self) -> bool:
        """Whether enough of the performer has been seen."""
        return self._seen >= _ENOUGH

    def add(self, time: float, result: TrackResult) -> Neutral:
        """Learn from a frame, smoothed as for display, in 2 ms, and return the neutral face.

        If the time in seconds decreases, as when a video starts over, everything is forgotten.
        """
        if not result.found:
            return self.neutral
        if not self._last < time < self._last + _LEFT:
            self._forget()
            self._last = self._moved = time
        self._seen += time - self._last
        self._last = time
        self._blinks.add(float(eye_apertures(result.shape).mean()), float(eye_apertures(self.neutral.shape).mean()))
        if not self.neutral.asked:
            self._rest.add(time, result)
        if (passed := time - self._moved) >= _STEP:
            self._approach(passed)
            self._moved = time
        return self.neutral

    def _forget(self) -> None:
        self._rest, self._blinks = _Rest(), _Blinks()
        self._last = self._moved = -inf
        self._seen = 0.0

    def _approach(self, passed: float) -> None:
        """Move some of the way towards the result, for `passed` seconds."""
        before, found = self.neutral, self._rest.found or self.neutral
        # Eyes that are shut on request are shut more tightly than in a blink, which the avatar has to show, too.
        left = self._blinks.left / max(float(eye_apertures(found.shape).mean()), 1e-9)
        found = replace(found, shut=max(self._shut, left) if left < MAX_SHUT else self._shut)
        off = float(np.abs(found.shape - before.shape).max(initial=abs(found.shut - before.shut)))
        if off > _UNCHANGED:
            self.neutral = _between(before, found, (1.0 - exp(-passed / _TIME)) * min(self._seen / _ENOUGH, 1.0))


class _Rest:
    """Searches frames that are spread over the performance for the face at rest, in small steps until it is found."""

    def __init__(self) -> None:
        self.found: Neutral | None = None
        self._kept: list[tuple[float, TrackResult]] = []
        self._interval = 1.0 / _RATE
        self._search = self._searching()

    def add(self, time: float, result: TrackResult) -> None:
        """Add a frame with a face, and continue the search."""
        if not self._kept or time >= self._kept[-1][0] + self._interval:
            self._kept.append((time, result))
        if len(self._kept) > _FRAMES:
            self._kept, self._interval = self._kept[::2], 2.0 * self._interval
        if len(self._kept) >= _MIN_FRAMES:
            for _ in range(_SWEEPS if self.found is not None else _AT_FIRST):
                next(self._search)

    def _searching(self) -> Iterator[None]:
        while True:
            recorder = TakeRecorder({})
            for time, result in self._kept:
                recorder.append(time, result)
            take, frames = recorder.finish(), np.arange(len(self._kept))
            activations = np.empty(0)
            for after in load_face_space().sweeps(take.shape.astype(np.float64), trust(take, frames)):
                activations = after
                yield
            self.found = rest_of(take, frames, activations)


class _Blinks:
    """Measures how far lids stay apart in blinks.

    `left` is the aperture of the eyes in a usual blink, in eye distances; NaN before the first blink.
    """

    def __init__(self) -> None:
        self.left = nan
        self._least: deque[float] = deque(maxlen=_BLINKS)
        self._during: list[float] = []

    def add(self, opening: float, at_rest: float) -> None:
        """Add the aperture of a frame, and that of the eyes at rest."""
        if opening < MAX_SHUT * at_rest:
            self._during.append(opening)
        elif self._during and opening > _REOPENED * at_rest:
            if len(self._during) >= _BLINK_FRAMES:
                self._least.append(min(self._during))
                self.left = float(np.median(self._least))
            self._during = []


def _between(before: Neutral, found: Neutral, share: float) -> Neutral:
    """Move `before` by a share of the way to `found`; values unknown in one are taken from the other."""

    def blend(name: str) -> FloatArray:
        old, new = (np.asarray(getattr(neutral, name), dtype=np.float64) for neutral in (before, found))
        moved = old + share * (new - old)
        return np.asarray(np.where(np.isnan(moved), np.where(np.isnan(old), new, old), moved))

    shape, position, gaze, actions = (blend(name) for name in ("shape", "position", "gaze", "actions"))
    old, new = (np.array(matrix_to_euler(neutral.rotation)) for neutral in (before, found))
    return replace(
        before,
        rotation=euler_to_matrix(*(old + share * (new - old))),
        shape=shape,
        position=position,
        gaze=gaze,
        actions=actions,
        shut=float(blend("shut")),
        vergence=float(blend("vergence")),
        start=found.start,
        end=found.end,
        removed=found.removed,
    )
