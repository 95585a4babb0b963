"""Takes as comma-separated values, for spreadsheets and scripts; takes.md lists the columns."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, SourceError
from ..face.landmarks import IBUG68_INDICES, eye_apertures, mouth_aperture
from ..face.names import ACTIONS, COEFFICIENTS
from ..files.capture import check_readable
from ..files.reading import shown
from ..files.writing import replacing
from .format import info_content, info_of
from .table_text import TextTable, parse_rows, read_table
from .take import DTYPES, Take, check_take
from .timing import project

_NOTE = "# facemime take "
_POSE = ("scale", "pitch", "yaw", "roll", "tx", "ty")
_SHOWN = ("eye_right_aperture", "eye_left_aperture", "mouth_aperture")
"""Columns that follow from the shape: written for reference, and ignored by `from_csv`."""


def _columns(modes: int) -> dict[str, list[str]]:
    """Return the names of the columns of each array of a take."""
    numbers = IBUG68_INDICES.tolist()
    return {
        "times": ["time"],
        "found": ["found"],
        "confidence": ["confidence"],
        "pose": list(_POSE),
        "gaze": ["gaze_pitch", "gaze_yaw"],
        "vergence": ["vergence"],
        "actions": [f"action_{name}" for name in ACTIONS],
        "teeth": ["teeth"],
        "coefficients": [f"coefficient_{name}" for name in COEFFICIENTS],
        "pupils": [f"pupil_{side}_{axis}" for side in ("right", "left") for axis in "xy"],
        "shape": [f"shape_{n}_{axis}" for n in numbers for axis in "xyz"],
        "landmarks": [f"landmark_{n}_{axis}" for n in numbers for axis in "xy"],
        "landmark_confidence": [f"confidence_{n}" for n in numbers],
        "shape_params": [f"mode_{n}" for n in range(modes)],
    }


_KNOWN = frozenset(name for names in _columns(0).values() for name in names)
_NEEDED = frozenset(_columns(0)["pose"] + _columns(0)["shape"])


def to_csv(take: Take, path: Path) -> None:
    """Write a take as a table with one row per frame, which `from_csv` reads back exactly.

    Raises OutputError if the file cannot be written.
    """
    columns = _columns(take.shape_params.shape[1])
    arrays = [getattr(take, name).reshape(len(take), -1) for name in columns]
    shown = np.column_stack([eye_apertures(take.shape), mouth_aperture(take.shape)]).astype(np.float32)
    with replacing(Path(path)) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow([_NOTE + info_content(take.info, len(take)).decode()])
        table.writerow([*(name for names in columns.values() for name in names), *_SHOWN])
        for row in range(len(take)):
            table.writerow([_text(value) for array in (*arrays, shown) for value in array[row]])


def _text(value: Any) -> str:
    """Return the shortest text that reads back as the same number; an empty one for an unknown number."""
    if isinstance(value, np.bool_):
        return str(int(value))
    return str(value) if np.isfinite(value) else ""


def from_csv(path: Path) -> Take:
    """Read a table written by `to_csv`, or another one with at least time, pose and shape.

    Columns may be in any order, and unknown ones are ignored. Without `found`, a frame has a face if its pose and shape
    are numbers; without landmarks, these are computed from shape and pose; other missing values are unknown. A
    SourceError states why the file cannot be read, which column it lacks, or which value is not a number.
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError(
            "There is no table {path}. Create one: facemime export TAKE -o {name}", path=path, name=path.name
        )
    try:
        table = read_table(path, _KNOWN.__contains__, _NOTE)
        if _NEEDED.isdisjoint(table.head):
            raise DataError("its columns are neither those of a take nor, at least ten, named as ARKit's coefficients")
        take, notes = parse_rows(table, partial(_read, table))
    except (ValueError, OSError, csv.Error) as error:
        raise SourceError(
            "{path} cannot be read as a take: {error}. Compare it with an exported one.", path=path, error=error
        ) from error
    return replace(take, info=take.info | {"notes": notes}) if notes else take


def _read(table: TextTable, cells: list[list[str]]) -> Take:
    info = info_of(table.note[len(_NOTE) :].encode())[0] if table.note else {}
    place = {name: column for column, name in enumerate(table.head) if name}
    columns = _columns(sum(name.startswith("mode_") for name in place))
    if missing := [n for key in ("times", "pose", "shape") for n in columns[key] if n not in place]:
        raise DataError("it has no column {column!r}", column=missing[0])
    arrays = {name: _values(cells, names, place) for name, names in columns.items()}
    complete = np.isfinite(np.concatenate([arrays["pose"], arrays["shape"]], axis=1)).all(axis=1)
    found = complete & (arrays["found"][:, 0] != 0.0 if "found" in place else True)
    shape = arrays["shape"].reshape(-1, len(IBUG68_INDICES), 3)
    landmarks = arrays["landmarks"].reshape(len(cells), -1, 2)
    if not any(name in place for name in columns["landmarks"]):
        landmarks[found] = project(shape[found], arrays["pose"][found])
    arrays |= {name: arrays[name][:, 0] for name in ("times", "vergence", "teeth")}
    arrays |= {"landmarks": landmarks, "shape": shape, "pupils": arrays["pupils"].reshape(-1, 2, 2)}
    arrays["confidence"] = np.nan_to_num(arrays["confidence"][:, 0], nan=1.0) * found
    rows: dict[str, Any] = {
        name: array.astype(DTYPES.get(name, np.float32)) for name, array in (arrays | {"found": found}).items()
    }
    take = Take(**rows, info=info)
    check_take(take)
    return take


def _values(cells: list[list[str]], names: list[str], place: dict[str, int]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Read the numbers of columns, (N, columns); NaN for empty cells and missing columns."""
    values = np.full((len(cells), len(names)), np.nan)
    for column, name in enumerate(names):
        at = place.get(name)
        for row, line in enumerate(cells):
            text = line[at].strip() if at is not None and at < len(line) else ""
            try:
                values[row, column] = float(text) if text else np.nan
            except ValueError:
                raise DataError(
                    "row {number} has {text} for {name}, which is not a number",
                    number=row + 1,
                    text=shown(text),
                    name=name,
                ) from None
    return values
