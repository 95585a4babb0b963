"""Recordings of other programs that are no tables of ARKit's coefficients (takes.md).

Audio2Face writes JSON, Face Cap a text of its own, and OpenFace a table of action units.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from io import StringIO
from itertools import islice
from math import pi
from pathlib import Path

import numpy as np

from ..errors import DataError, Message
from ..face.coefficient_names import COEFFICIENT_INDEX, N_COEFFICIENTS
from ..face.rotation import euler_to_matrix, from_face_axes, matrix_to_euler
from ..files.reading import as_list, as_number, as_object, as_text, parse_json, read_text
from ..heads.looks import LOOKS, looks_of
from ..numeric.arrays import FloatArray
from ..takes.table_text import TextTable, is_number
from .curves import CoefficientTrack, coefficients_of_keys

_MAX_FRAMES = 1_000_000
_MAX_CURVES = 1_000
_MAX_VALUE = 1e6
"""Largest value of a curve in Audio2Face's file."""
_AUDIO2FACE_RATE = 60.0
"""Frames per second of Audio2Face's file if it states none, as its importers assume."""
_FIRST_LINES = 10
"""Lines by which Face Cap's texts are recognised."""
_FIRST_CURVE = 12
"""Face Cap: k, milliseconds, position, rotation and two angles of each eye precede the curves."""
_ACTION_UNITS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "AU01": (("browInnerUp", 1.0),),
    "AU02": (("browOuterUp", 1.0),),
    "AU04": (("browDown", 1.0),),
    "AU05": (("eyeWide", 1.0),),
    "AU06": (("cheekSquint", 1.0),),
    "AU07": (("eyeSquint", 1.0),),
    "AU09": (("noseSneer", 1.0),),
    "AU10": (("mouthUpperUp", 1.0),),
    "AU12": (("mouthSmile", 1.0),),
    "AU14": (("mouthDimple", 1.0),),
    "AU15": (("mouthFrown", 1.0),),
    "AU17": (("mouthShrugLower", 1.0),),
    "AU20": (("mouthStretch", 1.0),),
    "AU23": (("mouthPress", 1.0),),
    "AU25": (("mouthLowerDown", 0.5), ("mouthUpperUp", 0.25)),
    "AU26": (("jawOpen", 1.0),),
    "AU45": (("eyeBlink", 1.0),),
}
"""What each action unit of OpenFace shows at its full intensity; a name without a side stands for both sides."""
OPENFACE_TITLES = frozenset(f"{unit}_r" for unit in _ACTION_UNITS)
"""Titles of its columns with the intensities of action units."""
_INTENSITY = 5.0
"""Largest intensity of OpenFace's action units."""
_POSE = ("pose_Rx", "pose_Ry", "pose_Rz")
"""Titles of OpenFace's columns with the rotation of the head."""
_GAZE = ("gaze_angle_x", "gaze_angle_y")
"""Titles of its columns with the gaze."""


def read_audio2face(path: Path) -> CoefficientTrack:
    """Read the JSON that Audio2Face exports; ValueError if it is anything else, OSError if it cannot be read."""
    data = as_object(parse_json(read_text(path)), "the file")
    names = [as_text(name, "a name") for name in as_list(data.get("facsNames"), "facsNames", _MAX_CURVES)]
    rows = as_list(data.get("weightMat"), "weightMat", _MAX_FRAMES)
    fps = as_number(data.get("exportFps", _AUDIO2FACE_RATE), "exportFps", 1.0, 1000.0)
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
    for number, row in enumerate(csv.reader(text.splitlines()), start=1):
        if row and row[0].strip() == "bs":
            names = [name.strip() for name in row[1:] if name.strip()]
        elif row and row[0].strip() == "k":
            cells = [cell.strip() for cell in row[1 : _FIRST_CURVE + len(names)]]
            if len(cells) < _FIRST_CURVE - 1 + len(names) or not all(map(is_number, cells)):
                raise DataError("line {number} is not a frame of {names} values", number=number, names=len(names))
            frames.append([float(cell) for cell in cells])
    values = np.array(frames)
    if not len(values) or not np.isfinite(values).all() or np.abs(values).max() > 1e15:
        raise DataError("it has no frames" if not frames else "it has values that are not possible numbers")
    coefficients, notes = coefficients_of_keys(dict(zip(names, values[:, _FIRST_CURVE - 1 :].T, strict=True)))
    turns = np.array([from_face_axes(*angles) for angles in (values[:, 4:7] * pi / 180.0).tolist()])
    moved = (values[:, 1:4] - values[0, 1:4]) * (1.0, -1.0, -1.0)
    return CoefficientTrack(values[:, 0] / 1000.0, coefficients, turns, moved, notes=notes)


def read_openface(table: TextTable) -> CoefficientTrack:
    """Read a table of OpenFace: action units, the rotation of the head, and the gaze; ValueError if it is damaged."""
    places = {title: place for place, title in enumerate(table.head)}
    rows = []
    for number, row in enumerate(table.lines, start=1):
        if number > _MAX_FRAMES:
            raise DataError("it has more than {max_frames:,} rows", max_frames=_MAX_FRAMES)
        if len(row) < len(table.head) or not all(map(is_number, row[: len(table.head)])):
            raise DataError("row {number} has a value that is not a number", number=number)
        rows.append([float(cell) for cell in row[: len(table.head)]])
    values = np.nan_to_num(np.array(rows, ndmin=2), posinf=0.0, neginf=0.0)
    if not rows or "timestamp" not in places:
        raise DataError("it has no times of frames")
    faces = values[:, places["face_id"]] if "face_id" in places else np.zeros(len(values))
    values = values[faces == faces[0]]
    columns = {title: values[:, place] for title, place in places.items()}
    coefficients = np.zeros((len(values), N_COEFFICIENTS))
    for unit, shows in _ACTION_UNITS.items():
        for source, gain in shows if f"{unit}_r" in columns else ():
            for name in [source] if source in COEFFICIENT_INDEX else [f"{source}Left", f"{source}Right"]:
                coefficients[:, COEFFICIENT_INDEX[name]] += gain * columns[f"{unit}_r"] / _INTENSITY
    turns = np.array([_turn(*angles) for angles in np.column_stack([columns.get(n, 0 * faces) for n in _POSE])])
    if set(_GAZE) <= set(columns):
        coefficients[:, LOOKS] = _looks(turns, columns[_GAZE[0]], columns[_GAZE[1]])
    rotations = np.array([matrix_to_euler(turn) for turn in turns])
    found = columns["success"] > 0.5 if "success" in columns else None
    note = Message("OpenFace's action units do not tell left from right. They were used for both sides.")
    return CoefficientTrack(columns["timestamp"], coefficients, rotations, found=found, notes=[note])


def _turn(x: float, y: float, z: float) -> FloatArray:
    """Return the rotation of OpenFace's angles, whose axes are those of an image: z first, then y, then x."""
    return euler_to_matrix(x, 0.0, 0.0) @ euler_to_matrix(0.0, y, 0.0) @ euler_to_matrix(0.0, 0.0, z)


def _looks(turns: FloatArray, across: FloatArray, down: FloatArray) -> FloatArray:
    """Return (N, 8) coefficients of both eyes' direction, whose angles OpenFace measures from the camera's axis."""
    seen = np.stack([np.tan(across), np.tan(down), -np.ones(len(across))], axis=1)
    own = (np.swapaxes(turns, 1, 2) @ seen[:, :, None])[..., 0]
    yaw, pitch = -np.arctan2(own[:, 0], -own[:, 2]), np.arctan2(own[:, 1], np.hypot(own[:, 0], own[:, 2]))
    eyes = [euler_to_matrix(0.0, y, 0.0) @ euler_to_matrix(p, 0.0, 0.0) for p, y in zip(pitch, yaw, strict=True)]
    return looks_of(np.repeat(np.array(eyes)[:, None], 2, axis=1))
