"""Takes of GNM's expressions by its landmarks alone, for want of its whole model (takes.md)."""

from __future__ import annotations

import numpy as np

from ..errors import DataError, Message
from ..face.landmarks import IBUG68_INDICES, LOWER_LIPS, UPPER_LIPS, outer_eye_distance
from ..heads.rig import neck_of
from .face_parameters import EXPRESSION, IDENTITY, Arrays, FaceParameters, check_shapes
from .measured import FacePoints, PointTracker, describe_animation
from .moving_mesh import TO_HEAD
from .take import Take, TakeRecorder

_EYES_APART = 0.09
"""Distance between the outer corners of a face's eyes in metres, the unit of the modes of GNM's landmarks."""
_MEDIAPIPE = (
    *(127, 234, 93, 58, 172, 136, 150, 149, 152, 378, 379, 365, 397, 288, 323, 454, 356),
    *(70, 63, 105, 66, 107, 336, 296, 334, 293, 300),
    *(168, 197, 5, 4, 98, 97, 2, 326, 327),
    *(33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380),
    *(61, 39, 37, 0, 267, 269, 291, 321, 314, 17, 84, 91),
    *(61, 37, 0, 267, 291, 314, 17, 84),
)
"""Point of MediaPipe's face mesh for each iBUG-68 landmark, among those that GNM's landmarks have: the inner rims of
the lips are those of the outer ones."""


def take_of_landmarks(source: str, given: FaceParameters, model: Arrays, fps: float) -> Take:
    """Return the take of GNM's expressions, by its landmarks alone; the head does not turn."""
    places, modes = np.asarray(model["rest"], dtype=np.float64), np.asarray(model["expression_modes"], np.float64)
    anchors = {int(point): place for place, point in enumerate(model["mediapipe_index"].tolist())}
    if lacking := sorted(set(_MEDIAPIPE) - anchors.keys()):
        raise DataError("it has no landmark {number}", number=lacking[0])
    check_shapes(rest=(places, (len(anchors), 3)), expression_modes=(modes, (len(modes), len(anchors), 3)))
    expressions = given.rows(EXPRESSION, len(modes))
    if IDENTITY in given and "identity_modes" in model:
        own = np.asarray(model["identity_modes"], dtype=np.float64)
        width = max(len(own), given.arrays[IDENTITY].size)
        places = places + np.tensordot(given.rows(IDENTITY, width)[0][: len(own)], own, 1)
    chosen = np.array([anchors[point] for point in _MEDIAPIPE])[IBUG68_INDICES]
    rest = places[chosen] * TO_HEAD
    rest[UPPER_LIPS] = rest[LOWER_LIPS] = (rest[UPPER_LIPS] + rest[LOWER_LIPS]) / 2.0
    unit = outer_eye_distance(rest) / _EYES_APART
    tracker = PointTracker(FacePoints(rest, rest), neck_of(rest), np.ones(len(rest)))
    recorder = TakeRecorder(describe_animation(source, fps))
    for number, values in enumerate(expressions):
        moved = rest + unit * np.tensordot(values, modes[:, chosen], 1) * TO_HEAD
        recorder.append(number / fps, tracker.result(FacePoints(moved, moved), np.eye(3), np.zeros(3)))
    take = tracker.finish(recorder)
    take.info["notes"] = [
        Message("By GNM's landmarks alone, the inner rims of the lips move as the outer ones, and the head is still.")
    ]
    return take
