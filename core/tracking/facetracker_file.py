"""Reading of a model of J. Saragih's FaceTracker, a text file that the user gives; Facemime ships none of it.

The file is a sequence of numbers: records that start with their type, and matrices as ``rows columns type values``.
Its model of a face has 66 points in Facemime's order and with Facemime's axes (x to the viewer's right, y down, z
away from the viewer), in pixels of its reference frame. All x come first, then all y, then all z. What follows the
model, a detector and a check of its appearance, is not used.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from ..errors import DataError, Message, ModelError
from ..face.landmarks import INNER, N_LANDMARKS
from ..face.rotation import fit_rotation
from ..files.reading import read_bytes
from ..numeric.arrays import FloatArray
from .linear_experts import LinearExpert, LinearModel, LinearView
from .model_file import unreadable
from .pdm import PointDistributionModel

MAX_BYTES = 4 << 20
"""Largest size of a file in bytes: five times that of the published model."""
_SHAPE, _EXPERT, _EXPERTS, _MODEL, _DETECTOR, _TRACKER = 0, 2, 3, 4, 5, 8
"""Types of records."""
_MATRICES = (4, 5, 6)
"""Types of matrices: whole numbers, and numbers of single and double precision."""
_MAX_VIEWS = 9
"""Largest number of views: three times that of the published model."""
_MAX_MODES = 196
"""Largest number of modes that 66 points in space can have without their pose, rounded up."""
_MAX_EXPERTS = 8
"""Largest number of experts of a landmark in a view."""
_MAX_SIDE = 31
"""Largest side of a patch in pixels: about three times that of the published model."""
_MAX_NUMBER = 1e9
"""Largest number; the published model has none above 100."""
_MAX_WEIGHT = 1e4
"""Largest weight, gain or offset of an expert."""
_SCALES = (8.0, 100.0)
"""Pixels per outer-eye distance that experts may see."""
_LARGEST_MISFIT = 0.2
"""Largest distance between the inner points of the mean shape and ours, root mean square, in outer-eye distances. The
published model has less than a tenth; points in another order, or with other axes, have more than a half."""
_MAX_MOTION = 2.0
"""Largest motion of a point by a standard deviation of a mode, in outer-eye distances."""
_ADVICE = Message("Choose face2.tracker from FaceTracker, or download it again.")


def is_text_model(path: Path) -> bool:
    """Whether a file starts as a text file of numbers does; False if it cannot be read."""
    try:
        with open(path, "rb") as stream:
            return stream.read(1).isdigit()
    except OSError:
        return False


def read_facetracker(path: Path, ours: PointDistributionModel) -> LinearModel:
    """Read a model, and turn its shape model into the head frame of `ours`.

    Raises ModelError if the file cannot be read, is damaged, or its points are not those of a face in our order.
    """
    try:
        content = read_bytes(path, MAX_BYTES)
        return _assemble(_Numbers(content), ours, hashlib.sha256(content).hexdigest()[:12])
    except ValueError as error:
        raise ModelError(
            "{path} is not a model of FaceTracker ({error}). {advice}", path=path, error=error, advice=_ADVICE
        ) from error
    except OSError as error:
        raise unreadable(path, error, _ADVICE) from error


class _Numbers:
    """The numbers of a file, taken in order; each method raises ValueError if they are not what is expected.

    They are converted when they are taken, as bytes that are no numbers follow the model.
    """

    def __init__(self, content: bytes) -> None:
        self._words = content.split()
        self._next = 0

    def take(self, count: int) -> FloatArray:
        words = self._words[self._next : self._next + count]
        if len(words) < count:
            raise DataError("it is truncated")
        self._next += count
        try:
            taken = np.array([float(word) for word in words])
        except ValueError as error:
            raise DataError("it has a word where a number should be") from error
        if not (np.abs(taken) <= _MAX_NUMBER).all():
            raise DataError("it has a number that is too large")
        return taken

    def whole(self, name: str, low: int, high: int) -> int:
        value = float(self.take(1)[0])
        if not low <= value <= high or value != int(value):
            raise DataError(
                "{name} is {value}, not a whole number from {low} to {high}", name=name, value=value, low=low, high=high
            )
        return int(value)

    def record(self, kind: int) -> None:
        self.whole("the type of a record", kind, kind)

    def skip(self, count: int) -> None:
        self._next += count

    def matrix(self, name: str, rows: int | None, columns: int | None, most: int = _MAX_MODES) -> FloatArray:
        """Take a matrix; None stands for any size from 1 to `most`."""
        height, width = (
            self.whole(name, 1 if side is None else side, most if side is None else side) for side in (rows, columns)
        )
        self.whole(name, _MATRICES[0], _MATRICES[-1])
        return self.take(height * width).reshape(height, width)


def _assemble(numbers: _Numbers, ours: PointDistributionModel, model_id: str) -> LinearModel:
    numbers.record(_TRACKER)
    numbers.record(_MODEL)
    count = numbers.whole("the number of views", 1, _MAX_VIEWS)
    numbers.record(_SHAPE)
    basis = numbers.matrix("the modes", 3 * N_LANDMARKS, None)
    variances = numbers.matrix("the variances", 1, basis.shape[1]).ravel()
    mean = numbers.matrix("the mean shape", 3 * N_LANDMARKS, 1)
    flat = numbers.matrix("the reference shape", 2 * N_LANDMARKS, 1).reshape(2, -1).T
    centres = np.array([numbers.matrix("the middle of a view", 3, 1)[:2, 0] for _ in range(count)])
    for _ in range(count):
        numbers.matrix("the visibility", N_LANDMARKS, 1)  # a hidden landmark has no experts
    views = tuple(LinearView(tuple(_experts(numbers) for _ in range(N_LANDMARKS))) for _ in range(count))
    numbers.record(_DETECTOR)  # otherwise the experts are of another layout
    turn, moved = _onto(mean.reshape(3, -1).T, ours.mean_shape)
    modes = np.einsum("ab,nbk->nak", turn, basis.reshape(3, N_LANDMARKS, -1).transpose(1, 0, 2))
    if variances.min() <= 0.0 or np.abs(modes * np.sqrt(np.abs(variances))).max() > _MAX_MOTION:
        raise DataError("the variances of its modes are not those of a face")
    ratio = [float(np.linalg.norm(p - p.mean(axis=0))) for p in (flat, moved[:, :2])]
    if not _SCALES[0] <= ratio[0] / ratio[1] <= _SCALES[1]:
        raise DataError("the reference shape has no usual size")
    if all(not view.visible.any() for view in views):
        raise DataError("it has no experts")
    return LinearModel(PointDistributionModel(moved, modes, variances), ratio[0] / ratio[1], centres, views, model_id)


def _experts(numbers: _Numbers) -> tuple[LinearExpert, ...]:
    numbers.record(_EXPERTS)
    numbers.skip(2)  # the size of the patches, which each repeats; without any, it is not initialised
    found = []
    for _ in range(numbers.whole("the number of experts", 0, _MAX_EXPERTS)):
        numbers.record(_EXPERT)
        kind = numbers.whole("the kind of an expert", 0, 2)
        gain, offset = numbers.take(2).tolist()
        weights = numbers.matrix("the side of a patch", None, None, _MAX_SIDE)
        if weights.shape[0] % 2 == 0 or weights.shape[1] % 2 == 0:
            raise DataError("the side of a patch is even")
        if max(abs(gain), abs(offset), float(np.abs(weights).max())) > _MAX_WEIGHT:
            raise DataError("an expert has a weight above {max_weight:g}", max_weight=_MAX_WEIGHT)
        found.append(LinearExpert(kind, gain, offset, weights.astype(np.float32)))
    return tuple(found)


def _onto(points: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit a scaled rotation (3, 3) from points (66, 3) to the target; also return the moved points (Umeyama 1991).

    Only inner points are used, as the jaw line is a contour in one model and a place on the skin in the other.
    """
    centre, aim = points[INNER].mean(axis=0), target[INNER].mean(axis=0)
    a, b = points[INNER] - centre, target[INNER] - aim
    rotation = fit_rotation(a, b)
    turn = float((b * (a @ rotation.T)).sum()) / max(float((a * a).sum()), 1e-12) * rotation
    moved: FloatArray = (points - centre) @ turn.T + aim
    # A face that has to be turned far does not look along our axes.
    away = float(np.sqrt(np.square(moved - target)[INNER].sum(axis=1).mean()))
    if not away <= _LARGEST_MISFIT or np.trace(rotation) < 2.5:
        raise DataError("its points are not those of a face in the usual order")
    return turn, moved
