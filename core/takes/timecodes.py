"""Timecodes: times of rows whose rate a table does not state (takes.md), and times as people read them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..files.reading import shown
from ..numeric.arrays import FloatArray

_PARTS = re.compile(r"[:;]")
"""Separators; a semicolon marks drop-frame timecodes, which skip numbers rather than frames."""
_RATES = (12.0, 15.0, 20.0, 24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 96.0, 100.0, 120.0, 144.0, 200.0)
_APP_RATE = 60.0
"""Rate of Live Link Face, assumed if no second of a table is complete."""
_NEAR = 0.06
"""Relative difference from a usual rate within which a measured one is that rate: dropped frames change it."""
_DROPPED = {30.0: 2.0, 60.0: 4.0}
"""Numbers that drop-frame timecodes skip at the start of each minute but every tenth, by rate."""
_NTSC = 1000.0 / 1001.0
"""Real rate of video with drop-frame timecodes, relative to that of their numbers."""
_DATE = re.compile(r"^\d{4}-\d\d-\d\d[T ]|(?:Z| ?UTC|[-+]\d\d:?\d\d)$")
"""Date and time zone of a time in the format of ISO 8601."""
_DAY = 86_400.0


def seconds_of_timecodes(texts: Sequence[str]) -> FloatArray:
    """Convert timecodes to seconds, also past midnight.

    Parameters
    ----------
    texts : sequence of str
        Hours, minutes, seconds and frames, the latter with decimals, as in 10:20:30:12.500; or hours, minutes and
        seconds with decimals, also after a date; or minutes and seconds with decimals.

    Returns
    -------
    (N,) float64
        Times in seconds.

    Raises
    ------
    ValueError
        If a text is not a timecode.

    Notes
    -----
    The frame numbers show the rate where they begin again: the last one before, the usual step and the first one after
    add up to it. Without such a place the rate is that of the app, or the lowest usual one above all frame numbers.
    A semicolon marks drop-frame timecodes, of 29.97 or 59.94 frames per second.
    """
    clocks = [_DATE.sub("", text.strip()) for text in texts]
    try:
        parts = np.array([[float(part) for part in _PARTS.split(clock)] for clock in clocks], dtype=np.float64)
    except ValueError:
        parts = np.empty(0)
    if parts.ndim == 2 and parts.shape[1] == 2 and "." in clocks[0]:
        parts = np.column_stack([np.zeros(len(parts)), parts])
    if parts.ndim != 2 or parts.shape[1] not in (3, 4) or not ((parts >= 0.0) & (parts < 1000.0)).all():
        raise DataError("{texts} is not a timecode such as 10:20:30:12.500", texts=shown(texts[0]))
    times = parts[:, :3] @ np.array([3600.0, 60.0, 1.0])
    days = _DAY * np.cumsum(np.diff(times, prepend=times[0]) < -_DAY / 2.0)
    if parts.shape[1] == 3:
        return np.asarray(times + days)
    rate = _rate(times, parts[:, 3])
    if ";" in clocks[0] and rate in _DROPPED:
        minutes = (times + days) // 60.0
        dropped = _DROPPED[rate] * (minutes - minutes // 10.0)
        return np.asarray(((times + days) * rate + parts[:, 3] - dropped) / (rate * _NTSC))
    return np.asarray(times + days + parts[:, 3] / rate)


def _rate(seconds: FloatArray, frames: FloatArray) -> float:
    """Return the frames per second of timecodes, given their whole seconds and frames, both (N,)."""
    highest = float(frames.max())
    above = [rate for rate in _RATES if rate > highest]
    same = np.diff(seconds) == 0.0
    steps = np.diff(frames)
    forward = steps[same & (steps > 0.0)]
    step = float(np.median(forward)) if len(forward) else 1.0
    found = _turnovers(seconds, steps, step)
    if not len(found):
        return max(above[0] if above else np.floor(highest) + 1.0, _APP_RATE)
    measured = float(np.median(found))
    near = min(_RATES, key=lambda rate: abs(rate - measured))
    if abs(near - measured) <= _NEAR * near and near > highest:
        return near
    return max(float(round(measured)), float(np.floor(highest)) + 1.0)


def _turnovers(seconds: FloatArray, steps: FloatArray, step: float) -> NDArray[np.float64]:
    """Return the rate at each place where the next second begins, (K,)."""
    turned = (np.diff(seconds) % _DAY == 1.0) & (steps < 0.0)
    return np.asarray(step - steps[turned])


def timecode(seconds: float) -> str:
    """Format a time as minutes and seconds, such as 1:05.2; tenths are rounded, and negative times have a sign."""
    tenths = round(10.0 * abs(seconds))
    sign = "-" if seconds < 0.0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"
