"""Recordings of other programs as takes, told apart by their content (takes.md).

Audio2Face writes JSON, Face Cap a text of its own, Unity clips, and OpenFace a table of action units.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from io import StringIO
from itertools import islice
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, Message, SourceError
from ..face.rotation import from_face_axes
from ..files.capture import check_readable
from ..files.reading import as_list, as_number, as_text, parse_json, read_text
from ..numeric.arrays import FloatArray
from .coefficient_table import from_any_csv, take_of_table
from .curves import CoefficientTrack, coefficients_of_keys, recorded
from .openface import TITLES, read_openface
from .rates import check_rate, unused_rate
from .table_angles import AUTOMATIC
from .table_json import table_of_json
from .table_text import SUFFIXES as TABLES
from .table_text import is_number, read_decoded, read_table
from .take import Take

_RATE = 60.0
"""Frames per second of a clip that states none, as Unity's editor has."""
_FASTEST = 1000.0
"""Largest number of frames per second that a clip may state."""
_MAX_FRAMES = 1_000_000
_FULL = 100.0
"""Weight at which a blend shape is fully shown."""
_HEADER = "%YAML"
_MAX_CURVES = 1_000
_MAX_VALUE = 1e6
"""Largest value of a curve in Audio2Face's file."""
_AUDIO2FACE = {"facsNames", "weightMat"}
"""What Audio2Face's file contains."""
_AUDIO2FACE_RATE = 60.0
"""Frames per second of Audio2Face's file if it states none, as its importers assume."""
_FIRST_LINES = 10
"""Lines by which Face Cap's texts are recognised."""
_FIRST_CURVE = 12
"""Face Cap: k, milliseconds, position, rotation and two angles of each eye precede the curves."""


_CURVE = re.compile(r"^  - (?:serializedVersion|curve|attribute|path|classID):", re.MULTILINE)
_ATTRIBUTE = re.compile(r"^    attribute: (?:'|\")?blendShape\.(.+?)(?:'|\")?\s*$", re.MULTILINE)
_KEY = re.compile(r"^[\s-]+time: (\S+)\s+value: (\S+)\s+inSlope: (\S+)\s+outSlope: (\S+)", re.MULTILINE)
_SAMPLES = re.compile(r"^  m_SampleRate: (\S+)", re.MULTILINE)


def read_unity_clip(path: Path) -> CoefficientTrack:
    """Read a clip that Unity saved as text; ValueError if it is anything else, OSError if it cannot be read."""
    text = read_text(path)
    if not text.startswith(_HEADER) or "AnimationClip:" not in text:
        raise DataError("it is not a clip that Unity saved as text (Edit > Project Settings > Editor > Force Text)")
    body = text.partition("  m_FloatCurves:")[2]
    body = body[: match.start()] if (match := re.search(r"^  m_\w+:", body, re.MULTILINE)) else body
    starts = [match.start() for match in _CURVE.finditer(body)]
    keys: dict[str, FloatArray] = {}
    for start, end in zip(starts, [*starts[1:], len(body)], strict=True):
        curve = "  " + body[start + 2 : end].replace("- ", "  ", 1)
        if (named := _ATTRIBUTE.search(curve)) is not None:
            points = np.array([[_number(cell) for cell in key] for key in _KEY.findall(curve)]).reshape(-1, 4)
            if len(points):  # the first mesh counts, as others that have the same key show the same
                keys.setdefault(named[1], points[np.argsort(points[:, 0], kind="stable")])
    if not keys:
        raise DataError("it has no curves of blend shapes")
    rate = _number(match[1]) if (match := _SAMPLES.search(text)) else _RATE
    if not 0.0 < rate <= _FASTEST:
        raise DataError("it states {rate:g} frames per second", rate=rate)
    first, last = min(of[0, 0] for of in keys.values()), max(of[-1, 0] for of in keys.values())
    if (last - first) * rate > _MAX_FRAMES:
        raise DataError("it has more than {max_frames:,} frames", max_frames=_MAX_FRAMES)
    times = first + np.arange(round((last - first) * rate) + 1) / rate
    curves = {name: _sampled(of, times) / _FULL for name, of in keys.items()}
    values, notes = coefficients_of_keys(curves)
    return CoefficientTrack(times, values, notes=notes)


def _number(text: str) -> float:
    """Read a number, or a slope, which is infinite where a curve jumps."""
    value = float(text.replace("Infinity", "inf"))
    if np.isnan(value):
        raise DataError("it has values that are not possible numbers")
    return value


def _sampled(keys: FloatArray, times: FloatArray) -> FloatArray:
    """Evaluate a curve of keys (K, 4), time, value and slopes before and after, which is a cubic between two keys."""
    places = np.clip(np.searchsorted(keys[:, 0], times, side="right") - 1, 0, max(len(keys) - 2, 0))
    if len(keys) == 1:
        return np.full(len(times), keys[0, 1])
    begin, end = keys[places], keys[places + 1]
    span = np.maximum(end[:, 0] - begin[:, 0], 1e-9)
    at = np.clip((times - begin[:, 0]) / span, 0.0, 1.0)
    jumps = ~np.isfinite(begin[:, 3]) | ~np.isfinite(end[:, 2])
    leave, arrive = (np.where(jumps, 0.0, slope) * span for slope in (begin[:, 3], end[:, 2]))
    smooth = at * at * (3.0 - 2.0 * at)
    bend = at * (1.0 - at) * ((1.0 - at) * leave - at * arrive)
    curve = begin[:, 1] + smooth * (end[:, 1] - begin[:, 1]) + bend
    return np.asarray(np.where(jumps, np.where(at < 1.0, begin[:, 1], end[:, 1]), curve))


def read_audio2face(data: Mapping[str, Any], fps: float | None = None) -> CoefficientTrack:
    """Read what the JSON that Audio2Face exports contains; ValueError if it is damaged.

    Without `fps` the rate is that which the file states.
    """
    names = [as_text(name, "a name") for name in as_list(data.get("facsNames"), "facsNames", _MAX_CURVES)]
    rows = as_list(data.get("weightMat"), "weightMat", _MAX_FRAMES)
    fps = fps or as_number(data.get("exportFps", _AUDIO2FACE_RATE), "exportFps", 1.0, 1000.0)
    if not names or not rows:
        raise DataError("it has no frames")
    values = np.empty((len(rows), len(names)))
    for number, row in enumerate(rows):
        cells = as_list(row, "a frame", _MAX_CURVES)
        if len(cells) != len(names):
            raise DataError(
                "frame {number} has {cells} values for {names} names",
                number=number + 1,
                cells=len(cells),
                names=len(names),
            )
        values[number] = [as_number(cell, "a value", -_MAX_VALUE, _MAX_VALUE) for cell in cells]
    coefficients, notes = coefficients_of_keys(dict(zip(names, values.T, strict=True)))
    return CoefficientTrack(np.arange(len(rows)) / fps, coefficients, notes=notes)


def is_face_cap(text: str) -> bool:
    """Return whether a text begins as Face Cap's recordings do: lines of info, of names, and of frames."""
    lines = [line for line in islice(StringIO(text), _FIRST_LINES) if line.strip()]
    kinds = {line.partition(",")[0].strip() for line in lines}
    return "bs" in kinds and kinds <= {"info", "bs", "k"}


def read_face_cap(text: str) -> CoefficientTrack:
    """Read a recording of Face Cap; ValueError if it is damaged."""
    names: list[str] = []
    frames: list[list[float]] = []
    notes: list[str] = []
    rows = [row for row in csv.reader(text.splitlines()) if any(row)]
    for number, row in enumerate(rows, start=1):
        if row and row[0].strip() == "bs":
            names = [name.strip() for name in row[1:] if name.strip()]
        elif row and row[0].strip() == "k":
            cells = [cell.strip() for cell in row[1 : _FIRST_CURVE + len(names)]]
            if len(cells) < _FIRST_CURVE - 1 + len(names) or not all(map(is_number, cells)):
                if number == len(rows) and len(frames) > 1:
                    notes.append(Message("The last row was cut short and was left out."))
                    break
                raise DataError("line {number} is not a frame of {names} values", number=number, names=len(names))
            frames.append([float(cell) for cell in cells])
    values = np.array(frames)
    if not len(values) or not np.isfinite(values).all() or np.abs(values).max() > 1e15:
        raise DataError("it has no frames" if not frames else "it has values that are not possible numbers")
    coefficients, recognised = coefficients_of_keys(dict(zip(names, values[:, _FIRST_CURVE - 1 :].T, strict=True)))
    turns = np.array([from_face_axes(*angles) for angles in (values[:, 4:7] * pi / 180.0).tolist()])
    moved = (values[:, 1:4] - values[0, 1:4]) * (1.0, -1.0, -1.0)
    return CoefficientTrack(values[:, 0] / 1000.0, coefficients, turns, moved, notes=[*notes, *recognised])


SUFFIXES = (*TABLES, ".json", ".anim")
"""Suffixes of what can be read."""
_MIN_UNITS = 8
"""Titles of OpenFace's action units by which its tables are recognised: half of the 17."""


def read_recording(path: Path, angles: str = AUTOMATIC, fps: float | None = None) -> Take:
    """Read a recording of another program, or a table of numbers.

    These are tables of coefficients and of takes, Audio2Face's and other JSON, Face Cap's text, OpenFace's table and
    Unity's clips. `angles` is the unit in which a table of coefficients has the rotation of the head: "automatic",
    "radians" or "degrees". `fps` is the rate of a file without times, or whose timecodes count frames. What was assumed
    is in ``info["notes"]``. A SourceError states why the file cannot be read.
    """
    path = Path(path)
    check_rate(fps)
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check its name.", path=path)
    suffix, program = path.suffix.lower(), ""
    try:
        if suffix == ".json":
            data = parse_json(read_text(path), nan=True)
            if not (isinstance(data, dict) and _AUDIO2FACE & data.keys()):
                return take_of_table(table_of_json(data), path.name, angles, fps)
            program = "Audio2Face"
            return recorded(read_audio2face(data, fps), path.name)
        if suffix == ".anim":
            program = "Unity"
            return recorded(_with_own_times(read_unity_clip(path), fps), path.name)
        if (found := _other_text(path, fps)) is not None:
            program, performance = found
            return recorded(performance, path.name)
    except (ValueError, OSError, csv.Error) as error:
        raise SourceError(
            "{path} cannot be read as a recording of {program}: {error}.",
            path=path,
            program=program or Message("a program"),
            error=error,
        ) from error
    return from_any_csv(path, angles, fps)


def _with_own_times(performance: CoefficientTrack, fps: float | None) -> CoefficientTrack:
    return replace(performance, notes=[*performance.notes, *unused_rate(fps)])


def _other_text(path: Path, fps: float | None) -> tuple[str, CoefficientTrack] | None:
    """Return what a text that is no table of coefficients shows, and the program that wrote it; None for a table."""
    if is_face_cap(text := read_decoded(path)):
        return "Face Cap", _with_own_times(read_face_cap(text), fps)
    table = read_table(path, TITLES.__contains__)
    return ("OpenFace", read_openface(table, fps)) if len(TITLES & set(table.head)) >= _MIN_UNITS else None
