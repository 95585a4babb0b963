"""Tables of action units with OpenFace's columns, as researchers' scripts read them (takes.md)."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import asin, atan2
from pathlib import Path

import numpy as np

from ..errors import DataError, Message
from ..face.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    IBUG68_INDICES,
    LIPS,
    MOUTH_CORNERS,
    NOSE,
    mouth_aperture,
)
from ..face.names import COEFFICIENT_INDEX, N_COEFFICIENTS
from ..face.rotation import euler_to_matrix, matrix_to_euler
from ..files.reading import shown
from ..files.writing import replacing
from ..heads.built_in import LOOKS, looks_of
from ..numeric.arrays import FloatArray
from .curves import CoefficientTrack
from .neutral import Neutral
from .table_faces import rows_of_one_face
from .table_text import TextTable, is_number, parse_rows
from .table_times import times_of_rows
from .take import Take

ACTION_UNITS: Mapping[str, tuple[tuple[str, float], ...]] = {
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
TITLES = frozenset(f"{unit}_r" for unit in ACTION_UNITS)
"""Titles of the columns with the intensities of action units."""
_PRESENT = (*ACTION_UNITS, "AU28")
"""Units whose presence is stated."""
_SUCKED = ("mouthRollLower", "mouthRollUpper")
"""What AU28 shows, which has no intensity."""
_SUCKED_IN = 0.5
"""Mean of these from which it is present."""
_IBUG68 = 68
_GAZE_VECTORS = tuple(f"gaze_{eye}_{axis}" for eye in (0, 1) for axis in "xyz")
"""Titles of the columns with the directions of the eyes: 0 is on the left of the image."""
_INTENSITY = 5.0
"""Largest intensity of an action unit."""
_TRACE = 1.0
"""Intensity from which a unit is present."""
_PARTED = 0.35
"""Gap of the lips beyond neutral, in outer-eye distances, at which AU25 has its largest intensity: that of a wide-open
mouth (method.md, section 4.2)."""
_EYE_DISTANCE = 90.0
"""Distance between the outer corners of the eyes of an adult in millimetres, by which distances from the camera are
estimated."""
_FOCAL = 500.0 / 640.0
"""Focal length relative to the width of the image, which OpenFace assumes for an unknown camera."""
_POSE = ("pose_Rx", "pose_Ry", "pose_Rz")
"""Titles of the columns with the rotation of the head."""
_GAZE = ("gaze_angle_x", "gaze_angle_y")
"""Titles of the columns with the gaze."""
_SEEN = {
    **dict.fromkeys(("AU01", "AU02", "AU04"), BROWS),
    **dict.fromkeys(("AU05", "AU06", "AU07", "AU45"), np.concatenate([EYE_RIGHT, EYE_LEFT])),
    "AU09": NOSE,
}
"""Landmarks whose certainty is that of a unit; of other units, those of the lips."""


def read_openface(table: TextTable, fps: float | None = None) -> CoefficientTrack:
    """Read a table of OpenFace: action units, the rotation of the head, and the gaze; ValueError if it is damaged.

    `fps` is the rate of a table of images, whose times are all 0.
    """
    track, notes = parse_rows(table, partial(_track, table.head, fps))
    return replace(track, notes=[*notes, *track.notes])


def _track(head: list[str], fps: float | None, rows: list[list[str]]) -> CoefficientTrack:
    places = {title: place for place, title in enumerate(head)}
    if "timestamp" not in places:
        raise DataError("it has no times of frames")
    for number, row in enumerate(rows, start=1):
        wrong = next(
            (title for place, title in enumerate(head) if not is_number("".join(row[place : place + 1]))), None
        )
        if wrong is not None:
            raise DataError(
                "row {number} has {text} for {name}, which is not a number",
                number=number,
                text=shown("".join(row[places[wrong] : places[wrong] + 1])),
                name=wrong,
            )
    rows, notes = rows_of_one_face(rows, head)
    times, assumed = times_of_rows(rows, head, fps)
    cells = np.array([[float(cell) for cell in row[: len(head)]] for row in rows])
    values = np.nan_to_num(cells, posinf=0.0, neginf=0.0)
    columns = {title: values[:, place] for title, place in places.items()}
    coefficients = np.zeros((len(values), N_COEFFICIENTS))
    for unit, shows in ACTION_UNITS.items():
        for source, gain in shows if f"{unit}_r" in columns else ():
            coefficients[:, _columns_of(source)] += gain * columns[f"{unit}_r"][:, None] / _INTENSITY
    turns = np.array([_turn(*angles) for angles in np.column_stack([columns.get(n, 0.0 * times) for n in _POSE])])
    if set(_GAZE) <= set(columns):
        coefficients[:, LOOKS] = _looks(turns, columns[_GAZE[0]], columns[_GAZE[1]])
    rotations = np.array([matrix_to_euler(turn) for turn in turns])
    found = columns["success"] > 0.5 if "success" in columns else None
    sides = Message("OpenFace's action units do not tell left from right. They were used for both sides.")
    return CoefficientTrack(times, coefficients, rotations, found=found, notes=[*notes, *assumed, sides])


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


def write_openface_csv(path: Path, take: Take, neutral: Neutral, coefficients: FloatArray) -> None:
    """Write a take as a table of action units, given ARKit's coefficients (F, 52) of its frames with a face.

    The columns are OpenFace's. A further column for each unit, such as AU12_doubt, states from 0 to 1 how uncertain it
    is: 1 minus the confidence in the face times the mean certainty of the landmarks that show the unit. Raises
    OutputError if the file cannot be written.
    """
    found = take.found
    intensities = np.zeros((len(take), len(ACTION_UNITS)))
    intensities[found] = _intensities(take.shape[found].astype(np.float64), neutral, coefficients)
    present = np.zeros((len(take), len(_PRESENT)))
    present[:, :-1] = intensities >= _TRACE
    present[found, -1] = coefficients[:, [COEFFICIENT_INDEX[name] for name in _SUCKED]].mean(axis=1) >= _SUCKED_IN
    looks = np.zeros((len(take), 8))
    looks[found] = [_gaze_columns(take, row) for row in np.flatnonzero(found).tolist()]
    poses = np.zeros((len(take), 6))
    poses[found] = _poses(take)
    points = np.zeros((len(take), 2, _IBUG68))
    points[found] = _all_points(take.landmarks[found]).swapaxes(1, 2)
    times = take.times - take.times[0]
    confidence = np.where(found, take.confidence, 0.0)
    columns = {
        "frame": np.arange(1, len(take) + 1),
        "face_id": np.zeros(len(take), int),
        "timestamp": times,
        "confidence": confidence,
        "success": found.astype(int),
    }
    titles = [*columns, *_GAZE_VECTORS, *_GAZE, "pose_Tx", "pose_Ty", "pose_Tz", *_POSE]
    titles += [f"{axis}_{number}" for axis in "xy" for number in range(_IBUG68)]
    titles += [*(f"{unit}_r" for unit in ACTION_UNITS), *(f"{unit}_c" for unit in _PRESENT)]
    titles += [f"{unit}_doubt" for unit in ACTION_UNITS]
    numbers = np.column_stack(
        [looks, poses, points.reshape(len(take), -1), intensities, present, 1.0 - _certainties(take, confidence)]
    )
    with replacing(Path(path)) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(titles)
        for begin, row in zip(
            zip(*(column.tolist() for column in columns.values()), strict=True), numbers, strict=True
        ):
            table.writerow([f"{value:.6g}" for value in (*begin, *row.tolist())])


def _intensities(shapes: FloatArray, neutral: Neutral, coefficients: FloatArray) -> FloatArray:
    """Intensities of the units, (N, 17), of shapes (N, 66, 3) and coefficients (N, 52)."""
    shown = np.empty((len(shapes), len(ACTION_UNITS)))
    for column, (unit, shows) in zip(shown.T, ACTION_UNITS.items(), strict=True):
        if unit == "AU25":  # an open jaw parts the lips, too, so what counts is the gap
            column[:] = (mouth_aperture(shapes) - mouth_aperture(neutral.shape)) / _PARTED
        else:
            ((source, _),) = shows
            column[:] = coefficients[:, _columns_of(source)].mean(axis=1)
    return np.asarray(_INTENSITY * shown.clip(0.0, 1.0))


def _columns_of(source: str) -> list[int]:
    """Columns of a coefficient, or of both sides of one."""
    names = [source] if source in COEFFICIENT_INDEX else [f"{source}Left", f"{source}Right"]
    return [COEFFICIENT_INDEX[name] for name in names]


def _gaze_columns(take: Take, frame: int) -> list[float]:
    """Directions of the right and left eye in the axes of the camera, and the two angles of their mean."""
    head = euler_to_matrix(*take.pose[frame, 1:4].tolist())
    pitch, yaw = np.nan_to_num(take.gaze[frame]).tolist()
    aside = 0.5 * float(np.nan_to_num(take.vergence[frame]))
    eyes = [-(head @ euler_to_matrix(pitch, yaw + turn, 0.0))[:, 2] for turn in (-aside, aside)]
    across, down, ahead = eyes[0] + eyes[1]
    return [*eyes[0].tolist(), *eyes[1].tolist(), atan2(across, -ahead), atan2(down, -ahead)]


def _poses(take: Take) -> FloatArray:
    """Position in millimetres and rotation in radians, (F, 6), of the frames with a face."""
    scale, tx, ty = take.pose[take.found][:, [0, 4, 5]].T
    width, height = take.info.get("image_size") or (2.0 * np.median(tx), 2.0 * np.median(ty))
    focal = _FOCAL * width
    distance = focal * _EYE_DISTANCE / scale
    place = distance[:, None] * np.column_stack([tx - width / 2.0, ty - height / 2.0, np.full(len(tx), focal)]) / focal
    turns = [_angles(euler_to_matrix(*angles)) for angles in take.pose[take.found, 1:4].tolist()]
    return np.column_stack([place, turns])


def _angles(turn: FloatArray) -> tuple[float, float, float]:
    """Angles that `_turn` converts to a rotation (3, 3)."""
    x, y = atan2(-turn[1, 2], turn[2, 2]), asin(float(np.clip(turn[0, 2], -1.0, 1.0)))
    return x, y, atan2(-turn[0, 1], turn[0, 0])


def _all_points(landmarks: FloatArray) -> FloatArray:
    """All 68 points (N, 68, 2) of landmarks (N, 66, 2): the inner corners of the mouth are the outer ones."""
    points = np.empty((len(landmarks), _IBUG68, 2))
    points[:, IBUG68_INDICES] = landmarks
    points[:, [60, 64]] = landmarks[:, MOUTH_CORNERS]
    return points


def _certainties(take: Take, confidence: FloatArray) -> FloatArray:
    """Certainty of each unit in each frame, (N, 17)."""
    known = np.nan_to_num(take.landmark_confidence)
    return np.column_stack([confidence * known[:, _SEEN.get(unit, LIPS)].mean(axis=1) for unit in ACTION_UNITS])
