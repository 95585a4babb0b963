"""Times of the rows of a table: which column has them, in which unit, and timecodes, also as people read them
(takes.md).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message
from ..files.reading import shown
from ..numeric.arrays import FloatArray
from .table_text import is_number

_RATE = 30.0
"""Rate in Hz of a table that states none."""
_UNITS = {"s": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9}
"""Seconds, and thousandths of the one before, by the first letter of their names."""
_SLOWEST = 1.0
"""Longest usual step between rows of a performance, seconds; a longer one shows a smaller unit."""
_LATEST = 1e19
"""Largest time: nanoseconds since 1970 have 19 digits."""


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
_DATE = re.compile(r"^\d{4}-\d\d-\d\d[T ]|(?:Z| ?UTC|[-+]\d\d:?\d\d)$")
"""Date and time zone of a time in the format of ISO 8601."""
_DAY = 86_400.0


def seconds_of_timecodes(texts: Sequence[str]) -> FloatArray:
    """Convert timecodes to seconds, also past midnight.

    These are hours, minutes, seconds and frames, the latter with decimals, as in 10:20:30:12.500; or hours, minutes and
    seconds with decimals, also after a date; or minutes and seconds with decimals. The frame numbers show the rate
    where they begin again: the last one before, the usual step and the first one after add up to it. Without such a
    place the rate is that of the app, or the lowest usual one above all frame numbers. A semicolon before the frames,
    or minutes that begin at frame 2 or 4, mark drop-frame timecodes, of 29.97 or 59.94 frames per second. Raises
    ValueError if a text is not a timecode.
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
    rate = _timecode_rate(times, parts[:, 3])
    if rate in _DROPPED and (";" in clocks[0] or _skips_numbers(times, parts[:, 3], _DROPPED[rate])):
        minutes = (times + days) // 60.0
        dropped = _DROPPED[rate] * (minutes - minutes // 10.0)
        return np.asarray(((times + days) * rate + parts[:, 3] - dropped) / (rate * _NTSC))
    return np.asarray(times + days + parts[:, 3] / rate)


def _timecode_rate(seconds: FloatArray, frames: FloatArray) -> float:
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


def _skips_numbers(seconds: FloatArray, frames: FloatArray, dropped: float) -> bool:
    """Return whether minutes begin at that number, given whole seconds and frames of timecodes, both (N,)."""
    begins = np.flatnonzero((np.diff(seconds) % _DAY == 1.0) & (seconds[1:] % 60.0 == 0.0)) + 1
    minutes = begins[seconds[begins] % 600.0 != 0.0]
    return bool(len(minutes)) and bool((np.floor(frames[minutes]) == dropped).all())


def _turnovers(seconds: FloatArray, steps: FloatArray, step: float) -> NDArray[np.float64]:
    """Return the rate at each place where the next second begins, (K,)."""
    turned = (np.diff(seconds) % _DAY == 1.0) & (steps < 0.0)
    return np.asarray(step - steps[turned])


def timecode(seconds: float) -> str:
    """Format a time as minutes and seconds, such as 1:05.2; tenths are rounded, and negative times have a sign."""
    tenths = round(10.0 * abs(seconds))
    sign = "-" if seconds < 0.0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"


_TIME = re.compile(
    r"(?:time(?:stamp)?|stamp|elapsed(?:time)?|t)?(?:in)?"
    r"(s|secs?|seconds?|ms|msecs?|millis|milliseconds?|us|usecs?|microseconds?|ns|nsecs?|nanoseconds?)?"
)
"""Titles of times, and their unit, as letters in lower case."""
_TIMECODE = re.compile(r"(?:smpte)?(?:timecodes?|tc)|smpte")
_FRAME = re.compile(r"frames?(?:number|no|nr|index|id|count)?")
_FRAME_RATE = re.compile(r"fps|framerate|framespersecond")


def is_title_of_time(title: str) -> bool:
    """Return whether a title is that of a column with times or numbers of frames."""
    letters = _letters(title)
    return bool(letters) and any(pattern.fullmatch(letters) for pattern in (_TIME, _TIMECODE, _FRAME, _FRAME_RATE))


def times_of_rows(rows: Sequence[Sequence[str]], head: Sequence[str]) -> tuple[FloatArray, list[str]]:
    """Read the seconds of rows (N,), and what was assumed; raises ValueError if a cell is not a time."""
    for pattern in (_TIMECODE, _TIME):
        if (place := _column(head, pattern)) is not None:
            texts = [_cell(row, place) for row in rows]
            if not is_number(texts[0]):
                return seconds_of_timecodes(texts), []
            return _seconds(_numbers(texts, head[place]), head[place])  # Audio2Face's timecodes are seconds
    rate, notes = _rate(rows[0], head)
    if (place := _column(head, _FRAME)) is not None:
        return _numbers([_cell(row, place) for row in rows], head[place]) / rate, notes
    return np.arange(len(rows)) / rate, notes


def _seconds(values: FloatArray, title: str) -> tuple[FloatArray, list[str]]:
    """Convert times to seconds, in the unit that the title states, or otherwise one that makes them a performance."""
    matched = _TIME.fullmatch(_letters(title))
    if matched is not None and matched[1]:
        return values * _UNITS[matched[1][0]], []
    step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    for unit, name in ((1e-9, "nanoseconds"), (1e-6, "microseconds"), (1e-3, "milliseconds")):
        if step * unit > _SLOWEST * 1e-3:
            return values * unit, [Message("Times were read as {name}.", name=name)]
    return values, []


def _rate(row: Sequence[str], head: Sequence[str]) -> tuple[float, list[str]]:
    """Return the frames per second of a table without times, and what was assumed."""
    place = _column(head, _FRAME_RATE)
    if place is not None and is_number(text := _cell(row, place)) and 1.0 <= float(text) <= 1000.0:
        return float(text), []
    return _RATE, [Message("The table has no times. Its rate was taken to be {rate:g} frames per second.", rate=_RATE)]


def _column(head: Sequence[str], pattern: re.Pattern[str]) -> int | None:
    titles = [_letters(title) for title in head]
    return next((place for place, title in enumerate(titles) if title and pattern.fullmatch(title)), None)


def _letters(title: str) -> str:
    return re.sub(r"[\W\d_]", "", title.lower())


def _cell(row: Sequence[str], column: int) -> str:
    return row[column] if column < len(row) else ""


def _numbers(texts: Sequence[str], name: str) -> FloatArray:
    for number, text in enumerate(texts):
        if not is_number(text) or not abs(float(text)) < _LATEST:
            raise DataError(
                "row {number} has {text} for {name}, which is not a possible number",
                number=number + 1,
                text=shown(text),
                name=name,
            )
    values = np.array(texts, dtype=np.float64)
    return np.asarray(values - values[0])
