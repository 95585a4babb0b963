"""Pins: landmarks of a take that a user has put in their places.

They are kept in `Take.info`, beside what was tracked, so that they can be removed. `correction` solves the take around
them whenever it is read.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, SourceError
from ..face.landmarks import IBUG68_INDICES, MIRROR, N_LANDMARKS, from_ibug
from ..files.capture import check_readable
from ..files.reading import shown
from ..files.writing import replacing
from ..numeric.arrays import FloatArray, IntArray
from .table_text import read_table
from .take import Take

PINS = "pins"
"""Entry of `Take.info` with the pins, as lists of their fields."""
LEARN = "learn_pins"
"""Entry of `Take.info` that says whether the pins also correct alike frames."""
MAX_PINS = 2048
"""Largest number of pins of a take; solving them takes a minute."""
COLUMNS = ("time", "landmark", "x", "y")
"""Columns of a table of pins: seconds, iBUG-68 number, pixels."""
_SAME = 1e-6
"""Difference in seconds between times that are the same."""
_LARGEST = 1e9
"""Number that no time in seconds and no position in pixels exceeds."""


@dataclass(frozen=True)
class Pin:
    """A landmark at its place: time in seconds, landmark 0 to 65, and position in pixels."""

    time: float
    landmark: int
    x: float
    y: float


def pins_of(take: Take) -> tuple[Pin, ...]:
    """Return the pins of a take; invalid ones, and too many, as a damaged file may have, are left out."""
    listed = take.info.get(PINS, [])
    return tuple(islice(_valid(listed), MAX_PINS)) if isinstance(listed, list) else ()


def _valid(listed: Iterable[Any]) -> Iterator[Pin]:
    for row in listed:
        if isinstance(row, list | tuple) and len(row) == 4 and all(type(value) in (int, float) for value in row):
            time, landmark, x, y = row
            if landmark in range(N_LANDMARKS) and all(abs(value) < _LARGEST for value in (time, x, y)):
                yield Pin(float(time), int(landmark), float(x), float(y))


def with_pins(take: Take, pins: Iterable[Pin]) -> Take:
    """Return a take with `pins` instead of its own; of those for one landmark at one time the last stays.

    Raises SourceError if there are too many.
    """
    rows = {(pin.time, pin.landmark): [float(pin.time), int(pin.landmark), float(pin.x), float(pin.y)] for pin in pins}
    if len(rows) > MAX_PINS:
        raise SourceError("{count} pins are more than {most}. Remove some.", count=len(rows), most=MAX_PINS)
    info = {key: value for key, value in take.info.items() if key != PINS}
    return replace(take, info={**info, PINS: [rows[key] for key in sorted(rows)]} if rows else info)


def learns_from_pins(take: Take) -> bool:
    """Return whether the pins of a take also correct alike frames."""
    return take.info.get(LEARN) is True


def with_learning(take: Take, learns: bool) -> Take:
    """Return a take whose pins also correct alike frames, or do not."""
    info = {key: value for key, value in take.info.items() if key != LEARN}
    return replace(take, info={**info, LEARN: True} if learns else info)


def frames_of_pins(take: Take, times: FloatArray) -> tuple[IntArray, NDArray[np.bool_]]:
    """Return which of the frames with a face is nearest to each time, (P,), and whether it is shown at that time."""
    seen = take.times[take.found]
    step = float(np.median(np.diff(take.times))) if len(take) > 1 else np.inf
    after = np.searchsorted(seen, times).clip(0, len(seen) - 1)
    before = np.maximum(after - 1, 0)
    rows = np.where(times - seen[before] <= seen[after] - times, before, after)
    return rows, np.abs(seen[rows] - times) <= 0.5 * step + _SAME


def shifted(pins: Iterable[Pin], seconds: float) -> tuple[Pin, ...]:
    """Return pins at later times."""
    return tuple(replace(pin, time=pin.time + seconds) for pin in pins)


def mirrored(pins: Iterable[Pin], width: float) -> tuple[Pin, ...]:
    """Return the pins of the mirrored take, whose images have a width in pixels."""
    return tuple(replace(pin, landmark=int(MIRROR[pin.landmark]), x=width - 1.0 - pin.x) for pin in pins)


def read_pins(path: Path) -> tuple[Pin, ...]:
    """Read a table of pins with the columns `COLUMNS`.

    Raises SourceError if the file is missing, or what it lacks.
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError(
            "There is no table {path}. Write one with the columns {columns}.", path=path, columns=", ".join(COLUMNS)
        )
    try:
        table = read_table(path, COLUMNS.__contains__)
        if missing := [name for name in COLUMNS if name not in table.head]:
            raise DataError("it has no column {column!r}", column=missing[0])
        places = [table.head.index(name) for name in COLUMNS]
        return tuple(_pin([row[at] if at < len(row) else "" for at in places]) for row in table.lines)
    except (ValueError, OSError, csv.Error) as error:
        raise SourceError(
            "{path} cannot be read as a table of pins: {error}. Its columns are {columns}.",
            path=path,
            error=error,
            columns=", ".join(COLUMNS),
        ) from error


def _pin(cells: list[str]) -> Pin:
    try:
        time, number, x, y = (float(cell) for cell in cells)
    except ValueError as error:
        raise DataError("{text} is not a pin", text=shown(", ".join(cells))) from error
    if not (all(abs(value) < _LARGEST for value in (time, x, y)) and number in IBUG68_INDICES):
        raise DataError("{text} is not a pin", text=shown(", ".join(cells)))
    return Pin(time, int(from_ibug([int(number)])[0]), x, y)


def pin_table(pins: Iterable[Pin]) -> str:
    """Return the text of a table that `read_pins` reads back exactly."""
    rows = [f"{pin.time!r},{IBUG68_INDICES[pin.landmark]},{pin.x!r},{pin.y!r}" for pin in pins]
    return "\n".join([",".join(COLUMNS), *rows, ""])


def write_pins(pins: Iterable[Pin], path: Path) -> None:
    """Write pins as a table; OutputError if the file cannot be written."""
    with replacing(Path(path)) as temporary:
        temporary.write_text(pin_table(pins), encoding="utf-8")
