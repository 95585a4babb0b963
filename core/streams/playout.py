"""Playout of a stream's frames: evenly, with a given delay after the earliest possible arrival, and a return to rest
when none come.

Times are the sender's, unless they turn out to say nothing. The offset of its clock from this computer's is the
smallest difference between arrival and time over some seconds, which neither jitter nor congestion lowers, and which
follows a clock that runs fast or slow.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass, field, replace
from itertools import count
from math import inf

import numpy as np

from ..puppet.sources import LiveFrame
from ..takes.neutral import Neutral
from ..takes.timing import between
from ..tracking.result import TrackResult
from .sender_times import SenderTimes

_BIN = 1.0
"""Seconds over which one smallest difference is taken."""
_BINS = 10
"""Number of these smallest differences that count."""
_SLEW = 0.05
"""Share of a frame's interval by which the estimated offset may change from frame to frame."""
_JUMP = 2.0
"""Seconds by which a time has to be off for the sender to count as restarted."""
_MAX_WAITING = 240
"""Largest number of frames that wait."""
HOLD = 0.5
"""Seconds for which the last face is held when no data arrive."""
EASE = 1.0
"""Seconds of its return to rest after that."""
RETURN = 0.2
"""Seconds of the transition back to the received motion."""


_INTERVAL = 1.0 / 30.0
"""Time between two frames in seconds that is assumed at first."""
_MIN_INTERVAL = 1e-3
"""Time between two frames in seconds above which it is learnt from."""
_MAX_INTERVAL = 0.5
"""Time between two frames in seconds below which it is learnt from."""
_PREDICTED = 2
"""Largest number of consecutive missing frames that are predicted."""
_DAMPING = 0.8
"""Share of the last motion that continues in each predicted frame."""
_MISSING = 1.6
"""Time between two frames, in intervals, above which a frame is missing between them."""
_PULL = 0.1
"""Share of the difference by which the times of frames without timestamps follow their arrival."""


@dataclass
class StreamCounts:
    """Numbers of packets.

    Attributes
    ----------
    received, accepted : int
        All packets, and those that were accepted.
    malformed : int
        Packets that do not follow the protocol.
    refused : int
        Packets not signed with the key, replayed, or not from the phone.
    flooded : int
        Packets that were not processed because too many came.
    late, doubled, lost : int
        Frames that came too late, came twice, or are missing, as far as the sender numbers them.
    """

    received: int = 0
    accepted: int = 0
    malformed: int = 0
    refused: int = 0
    flooded: int = 0
    late: int = 0
    doubled: int = 0
    lost: int = 0


@dataclass(order=True)
class _Waiting:
    time: float
    order: int
    arrival: float = field(compare=False)
    result: TrackResult = field(compare=False)
    sequence: int | None = field(compare=False, default=None)


@dataclass(frozen=True)
class Shown:
    """A frame that is due, with its time on the sender's clock and on this computer's, in seconds.

    Attributes
    ----------
    predicted : bool
        Whether the frame did not arrive, and continues the motion before it.
    """

    time: float
    due: float
    result: TrackResult
    predicted: bool = False


class ClockFollower:
    """Follows the difference between two clocks, one of which is read through a network with delays.

    If everything came later than `patience` seconds for a second, as when a network takes another route, earlier
    arrivals no longer count.
    """

    def __init__(self, patience: float = inf) -> None:
        self.offset: float | None = None
        self._patience = patience
        self._bins: deque[tuple[float, float]] = deque(maxlen=_BINS)

    def update(self, time: float, arrival: float, step: float) -> bool:
        """Change `offset` by at most `step` for a frame; all times are in seconds.

        Returns whether the sender's clock has jumped, so that everything starts again.
        """
        difference = arrival - time
        jumped = self.offset is not None and abs(difference - self.offset) > _JUMP
        if self.offset is None or jumped:
            self._bins.clear()
            self.offset = difference
        if not self._bins or arrival - self._bins[-1][0] >= _BIN:
            if self._bins and self._bins[-1][1] > self.offset + self._patience:
                self._bins.clear()
            self._bins.append((arrival, difference))
        else:
            began, least = self._bins[-1]
            self._bins[-1] = (began, min(least, difference))
        wanted = min(least for _, least in self._bins)
        self.offset += min(max(wanted - self.offset, -step), step)
        return jumped


class Playout:
    """A jitter buffer: frames go in as they arrive, and come out in order when they are due.

    They are due `delay` seconds after the earliest possible arrival. `counts` are of frames that came too late, came
    twice, or are missing; those missing are known only if the sender numbers its frames, as one without numbers may
    just have become slower.
    """

    def __init__(self, delay: float, counts: StreamCounts | None = None, *, predict: bool = True) -> None:
        self.counts = StreamCounts() if counts is None else counts
        self._delay, self._predict = delay, predict
        self._clock = ClockFollower(delay)
        self._times: SenderTimes | None = SenderTimes()
        self._waiting: list[_Waiting] = []
        self._order = count()
        self._interval = _INTERVAL
        self._entered: float | None = None
        self._last: list[Shown] = []
        self._sequence: int | None = None
        self._predicted = 0

    def push(self, result: TrackResult, time: float | None, arrival: float, sequence: int | None = None) -> bool:
        """Add a frame, and return whether it will be shown; otherwise it came too late or twice.

        `time` is in seconds on the sender's clock, or None if packets have no time, so that even intervals are assumed,
        as they are from the moment at which times turn out to say nothing; `arrival` is in seconds on this computer's;
        `sequence` is the number of the frame, if packets have one.
        """
        if time is not None and self._times is not None and self._times.useless(time, arrival, result):
            self._ignore(self._times)
        return self._enter(result, time if self._times is not None else None, arrival, sequence)

    def _ignore(self, times: SenderTimes) -> None:
        """Start again without the sender's times, with the frames that are waiting."""
        waiting = sorted(self._waiting, key=lambda frame: frame.order)
        self._interval = min(max(times.interval, _MIN_INTERVAL), _MAX_INTERVAL)
        self._times, self._clock = None, ClockFollower(self._delay)
        self._forget()
        for frame in waiting:
            self._enter(frame.result, None, frame.arrival, frame.sequence)

    def _forget(self) -> None:
        self._waiting.clear()
        self._last.clear()
        self._entered = None

    def _enter(self, result: TrackResult, time: float | None, arrival: float, sequence: int | None) -> bool:
        time = self._evenly(arrival) if time is None else time
        if self._clock.update(time, arrival, _SLEW * self._interval):
            self._forget()
        if self._last and time <= self._last[-1].time:
            again = any(time == shown.time for shown in self._last)
            self.counts.doubled += again
            self.counts.late += not again
            return False
        if any(time == waiting.time for waiting in self._waiting):
            self.counts.doubled += 1
            return False
        if self._entered is not None and time > self._entered:
            step = time - self._entered
            if _MIN_INTERVAL < step < _MAX_INTERVAL:
                # The smallest of recent steps, as missing frames make others longer.
                self._interval += (0.3 if step < self._interval else 0.02) * (step - self._interval)
        self._entered = time if self._entered is None else max(time, self._entered)
        heapq.heappush(self._waiting, _Waiting(time, next(self._order), arrival, result, sequence))
        if len(self._waiting) > _MAX_WAITING:
            heapq.heappop(self._waiting)
            self.counts.late += 1
        return True

    def due(self) -> float | None:
        """Return the time at which the next frame is due, on this computer's clock; None if none is waiting."""
        if self._clock.offset is None:
            return None
        return self._due(self._waiting[0].time) if self._waiting else self._gap()

    def pop(self, now: float) -> Shown | None:
        """Take the oldest frame that should be shown by `now`; None if it is too early for the next one."""
        due = self._due(self._waiting[0].time) if self._waiting else inf
        gap = self._gap()
        if gap is not None and gap <= now and gap < due:
            if now - gap <= self._interval:
                return self._prediction(gap)
            self._predicted = _PREDICTED  # too late to be of use
        return self._next() if due <= now else None

    def _next(self) -> Shown:
        waiting = heapq.heappop(self._waiting)
        shown = Shown(waiting.time, self._due(waiting.time), waiting.result)
        if self._sequence is not None and waiting.sequence is not None:
            steps = waiting.sequence - self._sequence
            self.counts.lost += steps - 1 if 0 < steps < _MAX_WAITING else 0
        self._sequence = waiting.sequence
        self._last = [*self._last[-1:], shown]
        self._predicted = 0
        return shown

    def _gap(self) -> float | None:
        """Return the time at which a missing frame would have been due, if it is to be predicted."""
        if not self._predict or self._predicted >= _PREDICTED or len(self._last) < 2:
            return None
        if not all(shown.result.found for shown in self._last):
            return None
        time = self._last[-1].time + (self._predicted + 1) * self._interval
        if self._waiting and self._waiting[0].time < time + (_MISSING - 1.0) * self._interval:
            return None
        return self._due(time)

    def _prediction(self, due: float) -> Shown:
        before, last = self._last
        self._predicted += 1
        time = last.time + self._predicted * self._interval
        if self._waiting:
            ahead = self._waiting[0]
            share = (time - last.time) / (ahead.time - last.time)
            if ahead.result.found:
                return Shown(time, due, between(last.result, ahead.result, share), predicted=True)
        speed = self._interval / max(last.time - before.time, _MIN_INTERVAL)
        share = 1.0 + speed * sum(_DAMPING ** (1 + n) for n in range(self._predicted))
        return Shown(time, due, between(before.result, last.result, share), predicted=True)

    def _due(self, time: float) -> float:
        assert self._clock.offset is not None
        return time + self._clock.offset + self._delay

    def _evenly(self, arrival: float) -> float:
        """Return a time for a frame without one, in even steps that follow the arrivals."""
        expected = arrival if self._entered is None else self._entered + self._interval
        if abs(arrival - expected) > 0.25:
            return arrival
        return max(expected + _PULL * (arrival - expected), (self._entered or 0.0) + 1e-6)


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
        """Make a live frame of one that came or was predicted, after `dropped` frames that were skipped.

        `neutral` is the neutral face of the source, if it states one; `now` is in seconds on this computer's clock, and
        the first frame has the time `start`.
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
