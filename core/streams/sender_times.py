"""A check whether the times of a sender say when its frames were made.

Some senders write the same time into many frames, whole seconds, or numbers that jump.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ..tracking.result import TrackResult

_JUDGED = 16
"""Number of frames that are judged together, about half a second."""
_ODD = 4
"""Number of them with odd times from which the times say nothing. Packets that are delayed by up to 0.4 s at random,
30 % of which come twice, have fewer in ten minutes; numbers that are random within each second have them after 7."""
_OFF = 0.4
"""Seconds by which a time has to be before the newest one, or ahead of its arrival, to be odd (see `_ODD`)."""
_RESTARTED = 2.0
"""Seconds before the newest time from which the sender has restarted, so that later times are compared with this one.
The same as for the clock (`playout.py`)."""


class SenderTimes:
    """Watches the times of a sender."""

    def __init__(self) -> None:
        self._odd: deque[bool] = deque(maxlen=_JUDGED)
        self._arrivals: deque[float] = deque(maxlen=_JUDGED)
        self._newest: tuple[float, TrackResult] | None = None
        self._before = 0.0

    @property
    def interval(self) -> float:
        """Mean time in seconds between the arrivals of the last frames, of which there are two at least."""
        return (self._arrivals[-1] - self._arrivals[0]) / (len(self._arrivals) - 1)

    def useless(self, time: float, arrival: float, result: TrackResult) -> bool:
        """Add a frame with its time and arrival in seconds, and return whether the times say nothing."""
        if self._newest is not None:
            newest, face = self._newest
            # Behind a congestion, times are behind their arrivals: only the opposite is odd.
            ahead = (time - self._before) - (arrival - self._arrivals[-1])
            again = time == newest and not _alike(face, result)
            self._odd.append(again or time < newest - _OFF or ahead > _OFF)
        if self._newest is None or time >= self._newest[0] or time < self._newest[0] - _RESTARTED:
            self._newest = time, result
        self._before = time
        self._arrivals.append(arrival)
        return sum(self._odd) >= _ODD


def _alike(first: TrackResult, second: TrackResult) -> bool:
    """Return whether two frames are the same, so that one is a copy that the network or the sender made."""
    return first is second or all(
        np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True)
        for name in ("pose", "shape", "gaze", "coefficients")
    )
