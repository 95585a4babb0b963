"""Tables of ARKit's coefficients, as written by Live Link Face and other programs: reading as takes, and writing.

Columns are found by name, as at least three orders are in use.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import floor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, SourceError
from ..face.names import COEFFICIENT_INDEX, COEFFICIENTS, N_COEFFICIENTS, column_of
from ..files.capture import check_readable
from ..files.reading import shown
from ..files.writing import replacing
from ..numeric.arrays import FloatArray
from .curves import coefficient_take
from .rates import unused_rate
from .spreadsheet import from_csv
from .table_angles import AUTOMATIC, EYES, HEAD, angle_of, eye_angles, head_angles, poses_of, unit_of_angles
from .table_faces import columns_of_one_node, rows_of_one_face
from .table_text import TextTable, parse_rows, read_table
from .table_times import is_title_of_time, times_of_rows
from .take import Take

_MIN_NAMES = 10
"""Smallest number of known coefficients in a table of coefficients."""
_MAX_NUMBER = 1e15
_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-"}
"""Cells without a number, as other programs write them, in lower case."""
_MOST = 5.0
"""A coefficient above this is a percentage, or an outlier: exaggerated ones reach 2."""
_FEW_HIGH = 0.1
"""Largest share of rows with such a coefficient for which these may be outliers; more than half in a recording of
percentages."""
_EXAGGERATED = 2.0
"""Largest coefficient of most other rows above which these are percentages, too: small ones."""
_AT_REST = 0.05
"""Largest coefficient of most other rows below which nothing but the percentages moves."""
_USUAL = 0.9
"""Share of the other rows that these two are about."""
_DECIMALS = 12
"""Decimals of a number, with which a float32 of a coefficient above 0.0001 is the same again."""
_FEW = 0.02
"""Largest share of rows that may be left out because their times do not increase."""
_SHORT = 10
"""Rows below which none may be left out: a table of a few rows is refused instead."""
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


def from_any_csv(path: Path, angles: str = AUTOMATIC, fps: float | None = None) -> Take:
    """Read a table of either kind: of coefficients, or as written by `to_csv`; SourceError as for these."""
    if has_coefficients(path):
        return from_coefficient_csv(path, angles, fps)
    take = from_csv(path)
    notes = [*take.info.get("notes", []), *unused_rate(fps)]
    return replace(take, info=take.info | {"notes": notes}) if notes else take


def has_coefficients(path: Path) -> bool:
    """Return whether a table's first line names coefficients; False for a file that cannot be read."""
    try:
        return len(_columns(read_table(path, _is_known).head)) >= _MIN_NAMES
    except (OSError, ValueError, csv.Error):
        return False


def _is_known(title: str) -> bool:
    return column_of(title) is not None or is_title_of_time(title)


def from_coefficient_csv(path: Path, angles: str = AUTOMATIC, fps: float | None = None) -> Take:
    """Read a table with a row per frame and a column for each known coefficient.

    Times are those of the column `Timecode`, as in Live Link Face's tables, or of a column of seconds or parts of them;
    or follow from numbers of frames, or from 1/30 s between rows. `fps` is the rate of frames, rows, and timecodes that
    count frames. Rows whose time does not increase are left out if they are few. `HeadYaw` to `HeadRoll` and
    `LeftEyeYaw` to `RightEyeRoll` are those of Live Link Face, in radians or degrees; for "automatic", see
    `unit_of_angles`. Without those of the eyes, the gaze follows from the coefficients. Other columns are ignored, and
    coefficients without a column are 0; missing values and lone outliers are interpolated, and a row without any is a
    frame without a face. Of several faces, the one with most rows is read. Repeated titles and a last row that was cut
    short are left out. What was decided is in ``info["notes"]``. A SourceError states why the file cannot be read, or
    what is not a number.
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError("There is no table {path}. Check its name.", path=path)
    try:
        return take_of_table(read_table(path, _is_known), path.name, angles, fps)
    except (ValueError, OSError, csv.Error) as error:
        raise SourceError(
            "{path} cannot be read as a table of coefficients: {error}. Compare it with an exported one.",
            path=path,
            error=error,
        ) from error


def write_coefficient_csv(
    path: Path,
    times: FloatArray,
    values: FloatArray,
    rotations: FloatArray,
    eyes: FloatArray | None = None,
    *,
    live_link: bool,
    rate: float = 60.0,
) -> None:
    """Write a table of coefficients, under Live Link Face's titles with a timecode, or ARKit's names with seconds.

    The arrays are times (N,) in seconds; `values` (N, 52) in the order of `COEFFICIENTS`; `rotations` (N, 3) of the
    head relative to neutral, as in `TrackResult`; and `eyes` (N, 2, 2), the `(pitch, yaw)` of the right and the left
    eye relative to neutral in radians, by default 0, for which only Live Link Face has columns. `rate` is that of the
    timecode in frames per second. Raises OutputError if the file cannot be written.
    """
    order = LIVE_LINK_ORDER if live_link else COEFFICIENTS
    places = [COEFFICIENT_INDEX[name] for name in order]
    names = [name[0].upper() + name[1:] for name in order] if live_link else list(order)
    head = ["Timecode", "BlendShapeCount", *names, *HEAD, *EYES] if live_link else ["time", *names, *HEAD]
    looks = np.zeros((len(times), 2, 2)) if eyes is None else eyes
    with replacing(Path(path)) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(head)
        for time, row, turn, look in zip(times.tolist(), values[:, places], rotations, looks, strict=True):
            begin = [timecode(time, rate), "61"] if live_link else [repr(time)]
            angles = (*head_angles(turn), *(eye_angles(look) if live_link else ()))
            table.writerow([*begin, *(f"{value:.{_DECIMALS}f}" for value in (*row, *angles))])


def timecode(time: float, rate: float) -> str:
    """Format seconds as Live Link Face does, such as 10:20:30:12.500; negative times count as 0."""
    whole = floor(max(time, 0.0) * rate * 1000.0 + 0.5)
    frames, part = divmod(whole, 1000)
    seconds, frame = divmod(frames, round(rate))
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{frame:02d}.{part:03d}"


def _columns(head: Sequence[str]) -> dict[int, int]:
    """Return the coefficient of each column that has one."""
    found = {column: column_of(name.strip()) for column, name in enumerate(head)}
    return {column: place for column, place in found.items() if place is not None}


def take_of_table(table: TextTable, name: str, angles: str, fps: float | None) -> Take:
    """Return a table of coefficients as a take, as `from_coefficient_csv` does; ValueError if it cannot be."""
    columns = _columns(table.head)
    if len(columns) < _MIN_NAMES:
        raise DataError("only {columns} of its columns are coefficients", columns=len(columns))
    columns, of_nodes = columns_of_one_node(columns, table.head)
    read, notes = parse_rows(table, partial(_read, table.head, columns, angles, fps))
    notes += [*of_nodes, *read.notes]
    return coefficient_take(name, read.times, read.values, read.turns, eyes=read.eyes, found=read.found, notes=notes)


@dataclass(frozen=True)
class _Rows:
    """What the rows of a table have, as for `coefficient_take`."""

    times: FloatArray
    values: FloatArray
    turns: Sequence[FloatArray]
    eyes: Sequence[FloatArray | None]
    found: NDArray[np.bool_]
    notes: list[str]


def _read(head: Sequence[str], columns: dict[int, int], angles: str, fps: float | None, rows: list[list[str]]) -> _Rows:
    rows, notes = rows_of_one_face(rows, head)
    every, assumed = times_of_rows(rows, head, fps)
    notes += assumed
    kept = _increasing(every)
    times, rows = every[kept] - every[kept][0], [row for row, keep in zip(rows, kept, strict=True) if keep]
    if not kept.all():
        count, total = int((~kept).sum()), len(kept)
        notes.append(
            Message("{count} of {total} rows repeat an earlier time and were left out.", count=count, total=total)
        )
    values, found = _values(rows, head, columns, notes)
    turns, eyes = zip(*_poses(rows, head, values, angles, notes), strict=True)
    return _Rows(times, values, turns, eyes, found, notes)


def _values(
    rows: list[list[str]], head: Sequence[str], columns: dict[int, int], notes: list[str]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (N, 52) coefficients, and (N,) which rows have any; add what was decided to `notes`."""
    values, halves = np.zeros((len(rows), N_COEFFICIENTS)), defaultdict(list)
    for column, place in columns.items():
        halves[place].append(_numbers(rows, column, head[column]))
    for place, of in halves.items():
        values[:, place] = np.mean(of, axis=0)
    known = list(columns.values())
    found = np.isfinite(values[:, known]).any(axis=1)
    if not found.any():
        raise DataError("all its coefficients are missing")
    if not found.all():
        count, total = int((~found).sum()), len(found)
        notes.append(
            Message(
                "{count} of {total} rows have no coefficients and count as frames without a face.",
                count=count,
                total=total,
            )
        )
    if _are_percentages(np.nan_to_num(values[found])):
        values *= 0.01
        notes.append(Message("The coefficients were read as percentages."))
    wild = np.abs(values) > _MOST
    if wild.any():
        name = COEFFICIENTS[int(np.argwhere(wild)[0, 1])]
        notes.append(
            Message(
                "Values beyond {most:g} were interpolated: {count}, the first one of {name}.",
                count=int(wild.sum()),
                most=_MOST,
                name=name,
            )
        )
    return np.column_stack([_between(column) for column in np.where(wild, np.nan, values).T]), found


def _are_percentages(values: FloatArray) -> bool:
    """Return whether coefficients (N, 52) reach 100: many are above 5, or some are, and the others do not suit 1.

    If few rows have such a value, they may be outliers. In a table of percentages, the others then have small ones,
    which are still above 2, or nothing at all.
    """
    largest = values.max(axis=1)
    high = largest > _MOST
    if high.mean() > _FEW_HIGH:
        return True
    return bool(high.any()) and not _AT_REST <= np.quantile(largest[~high], _USUAL) <= _EXAGGERATED


def _between(values: FloatArray) -> FloatArray:
    """Interpolate the missing numbers of a column, (N,); 0 if all are missing."""
    there = np.isfinite(values)
    return np.interp(np.arange(len(values)), np.flatnonzero(there), values[there]) if there.any() else 0.0 * there


def _poses(
    rows: list[list[str]], head: Sequence[str], values: FloatArray, angles: str, notes: list[str]
) -> Iterator[tuple[FloatArray, FloatArray | None]]:
    """Yield the rotation of the head and the directions of the eyes of each row; add their unit to `notes`."""
    turns, stated = np.zeros((len(rows), len(HEAD) + len(EYES))), ""
    for column, title in enumerate(head):
        if (known := angle_of(title)) is not None:
            turns[:, known[0]] = _between(_numbers(rows, column, title))
            stated = known[1] or stated
    unit = (stated or unit_of_angles(turns, values)) if angles == AUTOMATIC else angles
    if turns.any():
        notes.append(Message("The angles were read as {unit}.", unit=unit))
    return zip(*poses_of(turns, unit), strict=True)


def _increasing(times: FloatArray) -> NDArray[np.bool_]:
    """Return (N,) which rows are later than all before; ValueError if too many are not."""
    before = np.maximum.accumulate(np.concatenate([[-np.inf], times[:-1]]))
    kept = times > before
    if (~kept).sum() > max(_FEW * len(times), 1.0) or (len(times) < _SHORT and not kept.all()):
        raise DataError("its times do not increase")
    return np.asarray(kept)


def _numbers(rows: list[list[str]], column: int, name: str) -> FloatArray:
    """Read the numbers of a column, (N,), NaN where they are missing."""
    values = np.full(len(rows), np.nan)
    for number, row in enumerate(rows):
        text = row[column] if column < len(row) else ""
        if text.lower() in _MISSING:
            continue
        try:
            values[number] = 0.01 * float(text[:-1]) if text.endswith("%") else float(text)
        except ValueError:
            values[number] = np.inf
        if not abs(values[number]) <= _MAX_NUMBER:
            raise DataError(
                "row {number} has {text} for {name}, which is not a possible number",
                number=number + 1,
                text=shown(text),
                name=name,
            )
    return values
