"""Times of the frames of one sender, and a return to rest when no frames come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..live.sources import LiveFrame
from ..takes.neutral import Neutral
from .playout import Shown

HOLD = 0.5
"""Seconds for which the last face is held when no data arrive."""
EASE = 1.0
"""Seconds of its return to rest after that."""
RETURN = 0.2
"""Seconds of the transition back to the received motion."""
_FILL_RATE = 1.0 / 60.0
_MAX_CHANGE = 1.0
"""Seconds by which the difference of two clocks may change from one frame to the next."""


class Timeline:
    """Makes live frames: increasing times for those that came, and a return to rest when none come."""

    def __init__(self) -> None:
        self._last: LiveFrame | None = None
        self._base = self._time = self._moment = 0.0
        self._rest = self._filled = 0.0
        self._from, self._back = 0.0, -np.inf

    @property
    def begun(self) -> bool:
        """Whether there has been a frame."""
        return self._last is not None

    def frame(self, shown: Shown, neutral: Neutral | None, now: float, dropped: int, start: float = 0.0) -> LiveFrame:
        """Make a live frame of one that came or was predicted.

        Parameters
        ----------
        neutral : Neutral or None
            Neutral face of the source, if it states one.
        now : float
            Time in seconds on this computer's clock.
        dropped : int
            Number of frames that were skipped before it.
        start : float
            Time of the first frame in seconds.
        """
        time = self._time_of(shown, start)
        if not shown.predicted:
            if self._rest > 0.0:
                self._from, self._back, self._rest = self._rest, now, 0.0
            self._time, self._moment = time, max(shown.due, self._moment)
        back = min((now - self._back) / RETURN, 1.0)
        rest = self._from * (1.0 - _smooth(back)) if back < 1.0 else self._rest
        self._last = LiveFrame(time, None, shown.result, now, dropped, neutral, shown.predicted, rest)
        return self._last

    def _time_of(self, shown: Shown, start: float) -> float:
        if self._last is None:
            self._base, self._moment = start - shown.time, shown.due
            return start
        elapsed, time = shown.due - self._moment, shown.time + self._base
        if shown.predicted or 0.0 < time - self._time < elapsed + _MAX_CHANGE:
            return time
        # The sender's clock has restarted: the elapsed time on this computer's clock is used.
        time = self._time + max(elapsed, 1e-3)
        self._base = time - shown.time
        return time

    def due(self) -> float | None:
        """Return the time at which the next frame has to be filled in; None while no face is held or eased to rest."""
        if self._last is None or self._last.result is None or not self._last.result.found or self._rest >= 1.0:
            return None
        return max(self._moment + HOLD, self._filled + _FILL_RATE)

    def filled(self, now: float) -> LiveFrame | None:
        """Make a frame on the way to rest, if it is time for one."""
        due = self.due()
        if due is None or now < due or self._last is None:
            return None
        self._filled, self._rest = now, max(self._rest, _smooth((now - self._moment - HOLD) / EASE))
        time = self._time + now - self._moment
        self._last = replace(self._last, time=time, taken=now, dropped=0, filled=True, rest=self._rest)
        return self._last


def _smooth(share: float) -> float:
    """Smooth transition from 0 to 1, without a jerk at either end."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)
