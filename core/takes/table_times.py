"""Times of the rows of a table: which column has them, in which unit (takes.md)."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ..errors import DataError, Message
from ..files.reading import shown
from ..numeric.arrays import FloatArray
from .table_text import is_number
from .timecodes import seconds_of_timecodes

_RATE = 30.0
"""Rate in Hz of a table that states none."""
_UNITS = {"s": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9}
"""Seconds, and thousandths of the one before, by the first letter of their names."""
_SLOWEST = 1.0
"""Longest usual step between rows of a performance, seconds; a longer one shows a smaller unit."""
_LATEST = 1e19
"""Largest time: nanoseconds since 1970 have 19 digits."""
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
    """Read the times of rows.

    Parameters
    ----------
    head : sequence of str
        Titles of the columns.

    Returns
    -------
    times : (N,) float64
        In seconds.

    Raises
    ------
    ValueError
        If a cell is not a time.
    """
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
