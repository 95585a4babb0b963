"""A check whether the times of a sender say when its frames were made.

Some senders write the same time into many frames, whole seconds, numbers that jump, or numbers of another unit or frame
rate than they should, so that their clock runs fast or slow.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ..numeric.arrays import FloatArray
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
_BIN = 1.0
"""Seconds of which the least difference between arrival and time is compared with that of others."""
_SPANS = (4, 6, 8, 12, 16, 24, 32, 48)
"""Numbers of these over which a clock is found to run fast or slow, so that a clock that runs ten times too fast is
found in four seconds, and one that is 2 % too fast in 16.
"""
_DRIFT = 0.01
"""Share by which a clock has to run fast or slow: a hundred times as much as clocks do, ten times as much as 29.97
frames a second that are said to be 30.
"""
_FAST = 0.3
"""Seconds by which a clock has to get ahead in such a span, and further than ever: they delay what is shown."""
_SLOW = _RESTARTED
"""Seconds by which a clock has to fall behind, as times do behind a network that becomes slower."""
_STRAIGHT = 0.15
"""Largest deviation from a steady drift, as a share of the whole. A single step has a third."""


class SenderTimes:
    """Watches the times of a sender."""

    def __init__(self) -> None:
        self._odd: deque[bool] = deque(maxlen=_JUDGED)
        self._arrivals: deque[float] = deque(maxlen=_JUDGED)
        self._newest: tuple[float, TrackResult] | None = None
        self._before = 0.0
        self._bins: deque[tuple[float, float]] = deque(maxlen=max(_SPANS) + 1)
        self._record = np.inf
        self._drifts = False

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
            if abs(ahead) > _RESTARTED:
                self._bins.clear()
                self._record = np.inf
            again = time == newest and not _alike(face, result)
            self._odd.append(again or time < newest - _OFF or ahead > _OFF)
        if self._newest is None or time >= self._newest[0] or time < self._newest[0] - _RESTARTED:
            self._newest = time, result
        self._before = time
        self._arrivals.append(arrival)
        self._compare(time, arrival)
        return self._drifts or sum(self._odd) >= _ODD

    def _compare(self, time: float, arrival: float) -> None:
        """Compare the two clocks, whenever a bin is full."""
        difference = arrival - time
        if self._bins and arrival - self._bins[-1][0] < _BIN:
            began, least = self._bins[-1]
            self._bins[-1] = (began, min(least, difference))
            return
        full = np.array(self._bins).reshape(-1, 2)
        spans = [(full[-count:], full[:-count, 1].min(initial=self._record)) for count in _SPANS if count <= len(full)]
        self._drifts |= any(_drifts(span, least) for span, least in spans)
        if len(full) == self._bins.maxlen:
            self._record = min(self._record, full[0, 1])
        self._bins.append((arrival, difference))


def _drifts(bins: FloatArray, before: float) -> bool:
    """Return whether (N, 2) arrivals and least differences are those of a clock that runs fast or slow.

    `before` is the least difference until then.
    """
    arrivals, differences = bins.T - bins[0][:, None]
    slope, start = np.polyfit(arrivals, differences, 1)
    drifted = slope * arrivals[-1]
    if abs(slope) < _DRIFT or (drifted < _SLOW and min(before, bins[0, 1]) - bins[-1, 1] < _FAST):
        return False
    off = np.abs(differences - start - slope * arrivals).max()
    return bool(off < _STRAIGHT * abs(drifted))


def _alike(first: TrackResult, second: TrackResult) -> bool:
    """Return whether two frames are the same, so that one is a copy that the network or the sender made."""
    return first is second or all(
        np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True)
        for name in ("pose", "shape", "gaze", "coefficients")
    )
