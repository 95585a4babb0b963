"""Timecodes and times of day in tables, of any rate, which most tables do not state (takes.md)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..files.reading import shown
from ..numeric.arrays import FloatArray

_PARTS = re.compile(r"[:;]")
"""Separators; a semicolon before the frames marks drop-frame timecodes, which skip numbers rather than frames."""
_RATES = (12.0, 15.0, 20.0, 24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 96.0, 100.0, 120.0, 144.0, 200.0)
_APP_RATE = 60.0
"""Rate of Live Link Face, assumed if no second of a table is complete."""
_NEAR = 0.06
"""Relative difference from a usual rate within which a measured one is that rate: dropped frames change it."""
_DROPPED = {30.0: 2.0, 60.0: 4.0}
"""Numbers that drop-frame timecodes skip at the start of each minute but every tenth, by rate."""
_NTSC = 1000.0 / 1001.0
"""Real rate of video with drop-frame timecodes, relative to that of their numbers."""
_DATE = re.compile(r"^\d{1,4}([-/.])\d{1,2}\1\d{1,4}(?:T|,? +)|(?:Z| ?UTC|[-+]\d\d:?\d\d)$")
"""Date and time zone of a time, in the format of ISO 8601 or with a date as people write it."""
_DAY = 86_400.0
_MILLISECOND = 1e-3
_LEAST_ROWS = 5
"""Rows from which decimals may be milliseconds: each row agrees by chance once in as many cases as the rate is."""


def seconds_of_timecodes(
    texts: Sequence[str], fps: float | None = None, stated: float | None = None
) -> tuple[FloatArray, bool]:
    """Convert timecodes to seconds (N,), also past midnight; return whether they count frames, which need a rate.

    These are hours, minutes, seconds and frames, the latter with decimals, as in 10:20:30:12.500; or hours, minutes and
    seconds with decimals, also after a date; or minutes and seconds with decimals. The frame numbers show the rate
    where they begin again: the last one before, the usual step and the first one after add up to it. Without such a
    place the rate is `fps`, the one that the table has `stated`, that of the app, or the lowest usual one above all
    frame numbers. `fps` may also be a real rate, such as 23.976 where numbers count to 24. A semicolon before the
    frames, or minutes that begin at frame 2 or 4, mark drop-frame timecodes, of 29.97 or 59.94 frames per second. Where
    the decimals of all frames are the milliseconds of the second, these are the times. Raises ValueError if a text is
    not a timecode, or the frame numbers contradict `fps`.
    """
    parts = _parts_of(texts)
    times = parts[:, :3] @ np.array([3600.0, 60.0, 1.0])
    days = _DAY * np.cumsum(np.diff(times, prepend=times[0]) < -_DAY / 2.0)
    if parts.shape[1] == 3:
        return np.asarray(times + days), False
    frames = parts[:, 3]
    if (of_second := _seconds_of_milliseconds(frames)) is not None:
        return np.asarray(times + days + of_second), False
    given = fps or stated or 0.0
    rate = _timecode_rate(times, frames, float(round(given)))
    if fps is not None and rate != round(fps):
        raise DataError("its timecodes count {rate:g} frames per second, not {fps:g}", rate=rate, fps=fps)
    if rate in _DROPPED and (";" in texts[0] or _skips_numbers(times, frames, _DROPPED[rate])):
        minutes = (times + days) // 60.0
        dropped = _DROPPED[rate] * (minutes - minutes // 10.0)
        return np.asarray(((times + days) * rate + frames - dropped) / (rate * _NTSC)), True
    real = given if round(given) == rate else rate
    return np.asarray(((times + days) * rate + frames) / real), True


def _parts_of(texts: Sequence[str]) -> FloatArray:
    """Return hours, minutes, seconds and, if timecodes have them, frames, (N, 3 or 4)."""
    parts = [_numbers_in(_DATE.sub("", text.strip())) for text in texts]
    usual = Counter(map(len, parts)).most_common(1)[0][0]
    for number, (numbers, text) in enumerate(zip(parts, texts, strict=True), start=1):
        if not numbers or len(numbers) != usual:
            raise DataError(
                "row {number} has {text}, which is not a timecode such as 10:20:30:12.500",
                number=number,
                text=shown(text),
            )
    return np.array(parts, dtype=np.float64)


def _numbers_in(clock: str) -> list[float]:
    """Return the three or four numbers of a timecode; none if it is anything else."""
    try:
        numbers = [float(part) for part in _PARTS.split(clock)]
    except ValueError:
        return []
    if len(numbers) == 2 and "." in clock:
        numbers = [0.0, *numbers]
    return numbers if len(numbers) in (3, 4) and all(0.0 <= number < 1000.0 for number in numbers) else []


def _seconds_of_milliseconds(frames: FloatArray) -> FloatArray | None:
    """Return the decimals of frames (N,) as parts of a second, (N,), if they are its milliseconds; otherwise None.

    They are if the frame numbers follow from them at a usual rate. Milliseconds are whole; where all are those of
    frames, these are the times.
    """
    whole = np.floor(frames)
    seconds = np.round(frames - whole, 3)
    if len(frames) < _LEAST_ROWS or not whole.any():
        return None
    agree = [r for r in _RATES if (np.abs(seconds * r - whole - 0.5) <= 0.5 + r * _MILLISECOND + 1e-6).all()]
    for rate in agree:
        exact = np.round(seconds * rate) / rate
        if (np.abs(exact - seconds) <= _MILLISECOND + 1e-9).all():
            return np.asarray(exact)
    return seconds if agree else None


def _timecode_rate(seconds: FloatArray, frames: FloatArray, given: float) -> float:
    """Return the frames per second of timecodes, given their whole seconds and frames, both (N,).

    `given` is the rate where no second is complete, if it is above all frames, and is as good as a usual one elsewhere.
    """
    highest = float(frames.max())
    above = [rate for rate in _RATES if rate > highest]
    same = np.diff(seconds) == 0.0
    steps = np.diff(frames)
    forward = steps[same & (steps > 0.0)]
    step = float(np.median(forward)) if len(forward) else 1.0
    found = _turnovers(seconds, steps, step)
    if not len(found):
        return given if given > highest else max(above[0] if above else np.floor(highest) + 1.0, _APP_RATE)
    measured = float(np.median(found))
    near = min((*_RATES, given), key=lambda rate: abs(rate - measured))
    if abs(near - measured) <= _NEAR * near and near > highest:
        return near
    return max(float(round(measured)), float(np.floor(highest)) + 1.0)


def _skips_numbers(seconds: FloatArray, frames: FloatArray, dropped: float) -> bool:
    """Return whether minutes begin at that number, given whole seconds and frames of timecodes, both (N,)."""
    begins = np.flatnonzero((np.diff(seconds) % _DAY == 1.0) & (seconds[1:] % 60.0 == 0.0)) + 1
    minutes = begins[seconds[begins] % 600.0 != 0.0]
    return bool(len(minutes)) and bool((np.floor(frames[minutes]) == dropped).all())


def _turnovers(seconds: FloatArray, steps: FloatArray, step: float) -> NDArray[np.float64]:
    """Return the rate at each place where the next second begins, (K,)."""
    turned = (np.diff(seconds) % _DAY == 1.0) & (steps < 0.0)
    return np.asarray(step - steps[turned])
