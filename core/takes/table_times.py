"""Times of the rows of a table: which column has them, in which unit, and times as people read them (takes.md)."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ..errors import DataError, Message
from ..files.reading import shown
from ..numeric.arrays import FloatArray
from .rates import unused_rate
from .table_text import is_number
from .table_timecodes import seconds_of_timecodes

_RATE = 30.0
"""Rate in Hz of a table that states none."""
_UNITS = {"s": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9}
"""Seconds, and thousandths of the one before, by the first letter of their names."""
_SLOWEST = 1.0
"""Longest usual step between rows of a performance, seconds; a longer one shows a smaller unit."""
_LATEST = 1e19
"""Largest time: nanoseconds since 1970 have 19 digits."""
_JUMP = 60.0
"""Seconds above which a step between rows may be a clock that was set: a longer pause is rare within a recording."""
_JUMP_STEPS = 100.0
"""Usual steps above which it may be one: the steps of a sparse table differ by less."""
_RISING = 0.9
"""Share of steps that have to be positive in a column that is only likely to have times."""
_FASTEST = 1000.0
"""Largest number of frames per second that a table may state."""


def timecode(seconds: float) -> str:
    """Format a time as minutes and seconds, such as 1:05.2; tenths are rounded, and negative times have a sign."""
    tenths = round(10.0 * abs(seconds))
    sign = "-" if seconds < 0.0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"


_UNIT = r"(?:in)?(s|secs?|seconds?|ms|msecs?|millis|milliseconds?|us|usecs?|microseconds?|ns|nsecs?|nanoseconds?)?"
_FORMAT = r"(?:y*m*d*h{1,2}mm?s{1,2}[msf]*)?"
"""Format of times in a title, as in Time (HH:MM:SS.mmm)."""
_TIME = re.compile(rf"(?:time(?:stamp)?|stamp|elapsed(?:time)?|t)?{_UNIT}")
"""Titles of times, and their unit, as letters in lower case."""
_WORDS = (
    "(?:unix|epoch|posix|utc|gmt|local|system|host|device|world|wall|clock|date|day|of|video|audio|media|stream|clip|"
    "take|camera|cam|image|frame|sample|capture|captured|recorded|recording|record|session|playback|play|game|sim|"
    "simulation|scene|sequence|presentation|pts|elapsed|relative|absolute|current|since|from|start|begin|log|ros|app|"
    "arkit|face|tracking|tracker|sensor|source|timeline|code)*"
)
"""Words around "time" in titles of other programs; not those of durations, such as exposure, delta or lifetime."""
_LIKELY_TIME = re.compile(rf"{_WORDS}(?:time(?:stamp)?|stamp){_WORDS}{_FORMAT}{_UNIT}")
_TIMECODE = re.compile(rf"{_WORDS}(?:ltc|smpte)?(?:timecodes?|tc){_WORDS}{_FORMAT}(?:at)?(?:fps|hz)?|smpte")
_FRAME = re.compile(r"frames?(?:number|no|nr|index|id|count)?(?:at)?(?:fps|hz)?")
_FRAME_RATE = re.compile(r"fps|framerate|framespersecond")
_STATED = re.compile(r"(\d+(?:\.\d+)?) ?_?(?:fps|hz)", re.IGNORECASE)
"""Rate within a title, as in Timecode (60 fps)."""
_KNOWN = (_TIMECODE, _TIME)


def is_title_of_time(title: str) -> bool:
    """Return whether a title is that of a column with times or numbers of frames."""
    letters = _letters(title)
    return bool(letters) and any(pattern.fullmatch(letters) for pattern in (*_KNOWN, _LIKELY_TIME, _FRAME, _FRAME_RATE))


def is_title_of_rate(title: str) -> bool:
    """Return whether a title is that of frames per second."""
    return bool(_FRAME_RATE.fullmatch(_letters(title)))


def times_of_rows(
    rows: Sequence[Sequence[str]], head: Sequence[str], fps: float | None = None
) -> tuple[FloatArray, list[str]]:
    """Read the seconds of rows (N,), and what was assumed; raises ValueError if a cell is not a time.

    `fps` is the rate of rows without times, or with numbers of frames or timecodes.
    """
    times, notes = _times(rows, head, fps)
    times, count, first = _without_jumps(times)
    if count:
        notes.append(
            Message(
                "Jumps in the times longer than the recording were closed: {count}, the first after row {first}.",
                count=count,
                first=first,
            )
        )
    return times, notes


def _times(rows: Sequence[Sequence[str]], head: Sequence[str], fps: float | None) -> tuple[FloatArray, list[str]]:
    assumed = Message("The table has no times. Its rate was taken to be {rate:g} frames per second.", rate=_RATE)
    known = _columns(head, _KNOWN)
    for column in dict.fromkeys((*known, *_columns(head, (_LIKELY_TIME,)))):
        texts = [_cell(row, column) for row in rows]
        if len(texts) > 1 and len(set(texts)) == 1:
            assumed = Message(
                "All rows have the same time. The rate was taken to be {rate:g} frames per second.", rate=_RATE
            )
            continue
        try:
            times, counts, notes = _read(texts, rows[0], head, column, fps)
        except DataError:
            if column in known:
                raise
            continue
        if column in known or len(times) == 1 or (np.diff(times) > 0.0).mean() >= _RISING:
            return times, notes if counts else [*notes, *unused_rate(fps)]
    frames = next(iter(_columns(head, (_FRAME,))), None)
    rate = fps or _stated(rows[0], head, frames)
    notes = [] if rate else [assumed]
    if frames is not None and len({_cell(row, frames) for row in rows}) > 1:
        return _numbers([_cell(row, frames) for row in rows], head[frames]) / (rate or _RATE), notes
    return np.arange(len(rows)) / (rate or _RATE), notes


def _read(
    texts: Sequence[str], row: Sequence[str], head: Sequence[str], column: int, fps: float | None
) -> tuple[FloatArray, bool, list[str]]:
    """Read the texts of a column as seconds (N,); return also whether they count frames, and what was assumed."""
    if is_number(texts[0]):  # Audio2Face's timecodes are seconds
        times, notes = _seconds(_numbers(texts, head[column]), head[column])
        return times, False, notes
    times, counts = seconds_of_timecodes(texts, fps, _stated(row, head, column))
    return times, counts, []


def _seconds(values: FloatArray, title: str) -> tuple[FloatArray, list[str]]:
    """Convert times to seconds, in the unit that the title states, or otherwise one that makes them a performance."""
    letters = _letters(title)
    matched = _TIME.fullmatch(letters) or _LIKELY_TIME.fullmatch(letters)
    if matched is not None and matched[1]:
        return values * _UNITS[matched[1][0]], []
    step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    for unit, name in ((1e-9, "nanoseconds"), (1e-6, "microseconds"), (1e-3, "milliseconds")):
        if step * unit > _SLOWEST * 1e-3:
            return values * unit, [Message("Times were read as {name}.", name=name)]
    return values, []


def _without_jumps(times: FloatArray) -> tuple[FloatArray, int, int]:
    """Return times (N,) whose jumps are usual steps, how many there were, and the number of the row before the first.

    A clock that is set while it records jumps by more than a minute, and by more than all the rest takes. Shorter
    pauses are kept, as are the steps of tables with few rows.
    """
    steps = np.diff(times)
    forward = steps[steps > 0.0]
    if not len(forward):
        return times, 0, 0
    usual = float(np.quantile(forward, 0.5, method="lower"))
    long = np.abs(steps) > max(_JUMP, _JUMP_STEPS * usual)
    jumps = long & (np.abs(steps) > np.maximum(steps[~long], 0.0).sum())
    if not jumps.any():
        return times, 0, 0
    closed = times[0] + np.concatenate([[0.0], np.cumsum(np.where(jumps, usual, steps))])
    return closed, int(jumps.sum()), int(jumps.argmax()) + 1


def _stated(row: Sequence[str], head: Sequence[str], column: int | None) -> float | None:
    """Return the frames per second that the title of a column or the first row states, if either does."""
    titled = _STATED.search(head[column]) if column is not None else None
    texts = [titled[1]] if titled else [_cell(row, place) for place in _columns(head, (_FRAME_RATE,))]
    return next((float(text) for text in texts if is_number(text) and 1.0 <= float(text) <= _FASTEST), None)


def _columns(head: Sequence[str], patterns: Sequence[re.Pattern[str]]) -> list[int]:
    """Return the columns whose titles fit a pattern, by the first one that they fit."""
    titles = [_letters(title) for title in head]
    return [n for pattern in patterns for n, title in enumerate(titles) if title and pattern.fullmatch(title)]


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
