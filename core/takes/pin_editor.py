"""Editing of the pins of a take, frame by frame, with its own undo, and the frames where a user should look first."""

from __future__ import annotations

import numpy as np

from ..face.landmarks import N_LANDMARKS
from ..numeric.arrays import FloatArray, IntArray
from .correction import solve_pins
from .learnt import PARTS
from .mending import find_outliers
from .pins import Pin, frames_of_pins, pins_of, with_pins
from .take import Take

_USUAL = 40
"""Number of frames, beside those with pins, with which a frame is solved while it is edited."""
_MOST_UNDONE = 256
"""Number of changes that can be undone."""
APART = 0.5
"""Least time in seconds between two doubtful frames, and between one and a pin."""
_LEAST = 0.1
"""Usual uncertainty below which it is not compared, as the face as a whole is nearly always certain."""
_FAILED = 1e6
"""Doubt of a failed fit, above any other."""


class PinEditor:
    """Edits the pins of a take, given as it was tracked, in one frame at a time.

    Attributes
    ----------
    take : Take
        The take with its current pins.
    frame : int
        The frame that is edited.
    """

    def __init__(self, take: Take, frame: int = 0) -> None:
        self.take = take
        self.frame = int(np.clip(frame, 0, len(take) - 1))
        self._before: list[tuple[Pin, ...]] = []
        self._undone: list[tuple[Pin, ...]] = []
        self._first = pins_of(take)
        self._doubtful: IntArray | None = None

    @property
    def time(self) -> float:
        """Time of the frame in seconds."""
        return float(self.take.times[self.frame])

    @property
    def found(self) -> bool:
        """Whether the frame has a face."""
        return bool(self.take.found[self.frame])

    @property
    def changed(self) -> bool:
        """Whether the pins differ from those at the start."""
        return pins_of(self.take) != self._first

    @property
    def certainty(self) -> FloatArray:
        """Certainty of each landmark in the frame, (66,), 0 to 1; 1 where it is unknown."""
        return np.asarray(np.nan_to_num(self.take.landmark_confidence[self.frame].astype(np.float64), nan=1.0))

    def pins(self) -> dict[int, Pin]:
        """Return the pins of the frame by landmark."""
        return {pin.landmark: pin for pin in pins_of(self.take) if self._is_here(pin)}

    def _is_here(self, pin: Pin) -> bool:
        return int(np.abs(self.take.times - pin.time).argmin()) == self.frame

    def landmarks(self) -> FloatArray:
        """Return the landmarks of the frame, solved around all pins, (66, 2) in pixels; NaN without a face."""
        take, pins = self.take, pins_of(self.take)
        if not pins or not self.found:
            return np.asarray(take.landmarks[self.frame], np.float64)
        nearest = np.abs(take.times - np.array([[pin.time] for pin in pins])).argmin(axis=1)
        some = np.linspace(0, len(take) - 1, _USUAL).astype(np.intp)  # which tell what is usual in the take
        frames = np.unique([*nearest[take.found[nearest]], *some[take.found[some]], self.frame])
        kept = [pin for pin, frame in zip(pins, nearest, strict=True) if take.found[frame]]
        few = solve_pins(with_pins(take.part(frames), kept))
        return np.asarray(few.landmarks[int(np.searchsorted(frames, self.frame))], np.float64)

    def place(self, landmark: int, x: float, y: float) -> None:
        """Pin a landmark at pixels, without a step of undo; see `mark`. Nothing happens without a face."""
        if self.found and 0 <= landmark < N_LANDMARKS:
            others = [pin for pin in pins_of(self.take) if not (self._is_here(pin) and pin.landmark == landmark)]
            self._set([*others, Pin(self.time, landmark, x, y)])

    def mark(self) -> None:
        """Remember the pins as they are, to return to them by `undo`."""
        self._before = [*self._before, pins_of(self.take)][-_MOST_UNDONE:]
        self._undone = []

    def remove(self, landmarks: IntArray) -> bool:
        """Remove the pins of landmarks in the frame, and return whether there were any."""
        kept = [pin for pin in pins_of(self.take) if not (self._is_here(pin) and pin.landmark in landmarks)]
        if len(kept) == len(pins_of(self.take)):
            return False
        self.mark()
        self._set(kept)
        return True

    def undo(self) -> bool:
        """Undo the last change, and return whether there was one."""
        return self._exchange(self._before, self._undone)

    def redo(self) -> bool:
        """Redo what was undone, and return whether there was anything."""
        return self._exchange(self._undone, self._before)

    def _exchange(self, source: list[tuple[Pin, ...]], target: list[tuple[Pin, ...]]) -> bool:
        if not source:
            return False
        target.append(pins_of(self.take))
        self._set(source.pop())
        return True

    def discard(self) -> None:
        """Return to the pins at the start."""
        self._set(self._first)

    def _set(self, pins: tuple[Pin, ...] | list[Pin]) -> None:
        self.take = with_pins(self.take, pins)

    def step(self, frames: int) -> None:
        """Go to a later or earlier frame."""
        self.frame = int(np.clip(self.frame + frames, 0, len(self.take) - 1))

    def go_to(self, time: float) -> None:
        """Go to the frame nearest to a time in seconds."""
        self.frame = int(np.abs(self.take.times - time).argmin())

    def next_pinned(self, direction: int = 1) -> bool:
        """Go to the next frame with a pin, or the one before, and return whether there is one."""
        times = np.array([pin.time for pin in pins_of(self.take) if not self._is_here(pin)])
        there = times[(times - self.time) * direction > 0.0]
        if not len(there):
            return False
        self.go_to(float(there.min() if direction > 0 else there.max()))
        return True

    def next_doubtful(self) -> bool:
        """Go to the next of the frames in which the tracker was least sure, and return whether there is one."""
        frames = doubtful_frames(self.take).tolist()
        if not frames:
            return False
        at = frames.index(self.frame) + 1 if self.frame in frames else 0
        self.frame = int(frames[at % len(frames)])
        return True


def doubtful_frames(take: Take) -> IntArray:
    """Return the frames in which the tracker was less sure than usual, the most doubtful one first.

    Each part of the face, and the face as a whole, is compared with its own usual certainty in the take; the worst
    counts. Failed fits come first. Frames near a pin, or near a more doubtful frame, are left out.
    """
    doubt = uncertainty(take)
    starts = np.searchsorted(take.times, take.times - APART, side="right")
    ends = np.searchsorted(take.times, take.times + APART, side="left")
    free = take.found & (doubt > 1.0)
    if (pins := pins_of(take)) and free.any():
        rows, shown = frames_of_pins(take, np.array([pin.time for pin in pins]))
        for frame in np.unique(np.flatnonzero(take.found)[rows[shown]]):
            free[starts[frame] : ends[frame]] = False
    chosen = []
    for frame in np.argsort(-doubt, kind="stable"):
        if free[frame]:
            chosen.append(frame)
            free[starts[frame] : ends[frame]] = False
    return np.array(chosen, dtype=np.intp)


def uncertainty(take: Take) -> FloatArray:
    """Uncertainty relative to the usual one, (N,): the largest of parts and face; 1 where none is known."""
    parts = [take.landmark_confidence[:, part].mean(axis=1) for part in PARTS]
    unsure = 1.0 - np.column_stack([*parts, take.confidence]).astype(np.float64)
    seen = take.found[:, None] & np.isfinite(unsure)
    doubt = np.ones(len(take))
    for values, known in zip(unsure.T, seen.T, strict=True):
        if known.any():
            usual = max(float(np.median(values[known])), _LEAST)
            doubt[known] = np.maximum(doubt[known], values[known] / usual)
    doubt[find_outliers(take)] = _FAILED
    return doubt
