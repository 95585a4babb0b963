"""Tables of ARKit's coefficients, as written by Live Link Face and other programs: reading as takes, and writing.

Columns are found by name, as at least three orders are in use.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from math import floor, isfinite, pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..capture import check_readable
from ..coefficient_names import COEFFICIENT_INDEX, COEFFICIENTS, N_COEFFICIENTS, column_of
from ..errors import SourceError
from ..files import replacing
from ..reading import shown
from ..rotation import from_face_axes, to_face_axes
from .from_animation import IMAGE_SIZE
from .from_coefficients import coefficient_face
from .spreadsheet import from_csv
from .table_text import TextTable, read_table
from .take import Take, TakeRecorder, describe
from .timecodes import seconds_of_timecodes

_MIN_NAMES = 10
"""Smallest number of known coefficients in a table of coefficients."""
_MAX_ROWS, _MAX_NUMBER = 1_000_000, 1e15
_SECONDS = {"time": 1.0, "seconds": 1.0, "timestamp": 1.0, "time_s": 1.0, "timestamp_ms": 1e-3, "time_ms": 1e-3}
"""Columns of times, by name in lower case, and their unit in seconds."""
_RATE = 30.0
"""Rate in Hz of a table without times."""
_ANGLES = ("headyaw", "headpitch", "headroll")
AUTOMATIC, RADIANS, DEGREES = "automatic", "radians", "degrees"
_FURTHEST = np.radians([100.0, 80.0, 70.0])
"""Yaw, pitch and roll, in radians, beyond which no head turns while its face is tracked."""
_FEW, _SHORT = 0.02, 10
"""Share of rows that may be left out, and rows below which none may: a table of a few rows is refused instead."""
LIVE_LINK_ORDER: tuple[str, ...] = (
    *("eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft"),
    *("eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight"),
    *("eyeSquintRight", "eyeWideRight", "jawForward", "jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel"),
    *("mouthPucker", "mouthRight", "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft"),
    *("mouthFrownRight", "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight"),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft", "mouthPressRight"),
    *("mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft"),
    *("browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff", "cheekSquintLeft"),
    *("cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut"),
)
"""The order of coefficients in Live Link Face's tables, which differs from that in its packets."""
_EYES = tuple(f"{side}Eye{axis}" for side in ("Left", "Right") for axis in ("Yaw", "Pitch", "Roll"))


def from_any_csv(path: Path, angles: str = AUTOMATIC) -> Take:
    """Read a table of either kind: of coefficients, or as written by `to_csv`; SourceError as for these."""
    return from_coefficient_csv(path, angles) if has_coefficients(path) else from_csv(path)


def has_coefficients(path: Path) -> bool:
    """Return whether a table's first line names coefficients; False for a file that cannot be read."""
    try:
        return len(_columns(read_table(path, _is_known).head)) >= _MIN_NAMES
    except (OSError, ValueError, csv.Error):
        return False


def _is_known(title: str) -> bool:
    return column_of(title) is not None or title.lower() in {"timecode", *_SECONDS, *_ANGLES}


def from_coefficient_csv(path: Path, angles: str = AUTOMATIC) -> Take:
    """Read a table with a row per frame and a column for each known coefficient.

    Times are those of the column `Timecode`, as in Live Link Face's tables, or of a column of seconds or milliseconds;
    without either, rows are 1/30 s apart. Rows whose time does not increase are left out if they are few. `HeadYaw`,
    `HeadPitch` and `HeadRoll` are radians, or degrees if any exceeds what a head can turn. Other columns are ignored,
    and missing coefficients are 0. What was decided is in ``info["notes"]``.

    Parameters
    ----------
    path : Path
    angles : {"automatic", "radians", "degrees"}
        Unit of the rotation of the head.

    Raises
    ------
    SourceError
        If the file cannot be read, or contains a value that is not a number; the message states it.
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError(f"There is no table {path}. Check its name.")
    try:
        return _take(read_table(path, _is_known), path.name, angles)
    except (ValueError, OSError, csv.Error) as error:
        raise SourceError(
            f"{path} cannot be read as a table of coefficients: {error}. Compare it with an exported one."
        ) from error


def write_coefficient_csv(
    path: Path, times: FloatArray, values: FloatArray, rotations: FloatArray, *, live_link: bool, rate: float = 60.0
) -> None:
    """Write a table of coefficients.

    Parameters
    ----------
    path : Path
        The file to write.
    times : (N,) float64
        Times in seconds.
    values : (N, 52) float64
        Coefficients in the order of `COEFFICIENTS`.
    rotations : (N, 3) float64
        Pitch, yaw and roll of the head relative to neutral in radians, as in `TrackResult`.
    live_link : bool
        Whether to write Live Link Face's columns, with a timecode, rather than a column of seconds and ARKit's names.
    rate : float
        Frames per second of the timecode.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    order = LIVE_LINK_ORDER if live_link else COEFFICIENTS
    places = [COEFFICIENT_INDEX[name] for name in order]
    names = [name[0].upper() + name[1:] for name in order] if live_link else list(order)
    turns = ["HeadYaw", "HeadPitch", "HeadRoll"]
    head = ["Timecode", "BlendShapeCount", *names, *turns, *_EYES] if live_link else ["time", *names, *turns]
    with replacing(Path(path)) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(head)
        for time, row, turn in zip(times.tolist(), values[:, places], rotations, strict=True):
            numbers = [f"{value:.9f}" for value in (*row, *_yaw_first(turn))]
            begin = [timecode(time, rate), "61"] if live_link else [repr(time)]
            table.writerow([*begin, *numbers, *(["0.000000000"] * len(_EYES) if live_link else [])])


def timecode(time: float, rate: float) -> str:
    """Format a time as Live Link Face does: hours, minutes, seconds, frames and thousandths of a frame.

    Parameters
    ----------
    time : float
        Time in seconds; negative times count as 0.
    rate : float
        Frames per second.

    Returns
    -------
    str
        The timecode, such as 10:20:30:12.500.
    """
    whole = floor(max(time, 0.0) * rate * 1000.0 + 0.5)
    frames, part = divmod(whole, 1000)
    seconds, frame = divmod(frames, round(rate))
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{frame:02d}.{part:03d}"


def _yaw_first(rotation: FloatArray) -> tuple[float, float, float]:
    pitch, yaw, roll = to_face_axes(rotation)
    return yaw, pitch, roll


def _columns(head: Sequence[str]) -> dict[int, int]:
    """Return the coefficient of each column that has one."""
    found = {column: column_of(name.strip()) for column, name in enumerate(head)}
    return {column: place for column, place in found.items() if place is not None}


def _take(table: TextTable, name: str, angles: str) -> Take:
    head = table.head
    columns = _columns(head)
    if len(columns) < _MIN_NAMES:
        raise ValueError(f"only {len(columns)} of its columns are coefficients")
    if len(set(columns.values())) < len(columns):
        raise ValueError("two of its columns are the same coefficient")
    rows = []
    for line in table.lines:
        rows.append(line)
        if len(rows) > _MAX_ROWS:
            raise ValueError(f"it has more than {_MAX_ROWS:,} rows")
    if not rows:
        raise ValueError("it has no rows")
    plain = [title.strip().lower() for title in head]
    every, notes = _times(rows, plain), []
    kept = _increasing(every)
    times, rows = every[kept] - every[kept][0], [row for row, keep in zip(rows, kept, strict=True) if keep]
    if not kept.all():
        count, total = int((~kept).sum()), len(kept)
        warning = f"{count} of {total} rows repeat an earlier time and were left out."
        notes.append(warning)
    values = np.zeros((len(rows), N_COEFFICIENTS))
    for column, place in columns.items():
        values[:, place] = _numbers(rows, column, head[column])
    turns = np.zeros((len(rows), 3))
    for place, title in enumerate(_ANGLES):
        if title in plain:
            turns[:, place] = _numbers(rows, plain.index(title), title)
    if turns.any():
        unit = _unit(turns) if angles == AUTOMATIC else angles
        turns *= pi / 180.0 if unit == DEGREES else 1.0
        warning = f"The rotation of the head was read as {unit}."
        notes.append(warning)
    take = _recorded(times, values, turns, name)
    return replace(take, info=take.info | ({"notes": notes} if notes else {}))


def _unit(turns: FloatArray) -> str:
    """Return the unit of yaw, pitch and roll of a head, (N, 3): radians, unless it would turn too far."""
    return DEGREES if (np.abs(turns).max(axis=0) > _FURTHEST).any() else RADIANS


def _increasing(times: FloatArray) -> NDArray[np.bool_]:
    """Return (N,) which rows are later than all before; ValueError if too many are not."""
    before = np.maximum.accumulate(np.concatenate([[-np.inf], times[:-1]]))
    kept = times > before
    if (~kept).sum() > max(_FEW * len(times), 1.0) or (len(times) < _SHORT and not kept.all()):
        raise ValueError("its times do not increase")
    return np.asarray(kept)


def _recorded(times: FloatArray, values: FloatArray, turns: FloatArray, name: str) -> Take:
    rate = 1.0 / float(np.median(np.diff(times))) if len(times) > 1 else _RATE
    face = coefficient_face()
    recorder = TakeRecorder(
        describe(name, min(max(rate, 1e-3), 1e5), IMAGE_SIZE, "coefficients")
        | {"measured": True, "calibration": face.neutral.to_dict()}
    )
    for time, row, turn in zip(times.tolist(), values, turns, strict=True):
        recorder.append(time, face.result(row, from_face_axes(float(turn[1]), float(turn[0]), float(turn[2]))))
    return recorder.finish()


def _times(rows: list[list[str]], head: list[str]) -> FloatArray:
    """Read the times of rows in seconds, (N,)."""
    place = head.index("timecode") if "timecode" in head else -1
    if place >= 0 and not _is_number(_cell(rows[0], place)):
        return seconds_of_timecodes([_cell(row, place) for row in rows])
    if place >= 0:  # Audio2Face's column of that name has seconds
        return _numbers(rows, place, "timecode")
    if named := [title for title in head if title in _SECONDS]:
        return np.asarray(_SECONDS[named[0]] * _numbers(rows, head.index(named[0]), named[0]))
    return np.arange(len(rows)) / _RATE


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _cell(row: list[str], column: int) -> str:
    return row[column].strip() if column < len(row) else ""


def _numbers(rows: list[list[str]], column: int, name: str) -> FloatArray:
    values = np.zeros(len(rows))
    for number, row in enumerate(rows):
        text = _cell(row, column)
        try:
            values[number] = float(text or 0.0)
        except ValueError:
            values[number] = np.nan
        if not isfinite(values[number]) or abs(values[number]) > _MAX_NUMBER:
            raise ValueError(f"row {number + 1} has {shown(text)} for {name}, which is not a possible number")
    return values
