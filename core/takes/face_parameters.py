"""Parameters of face models over time, as programs that track faces or animate them by speech write them (takes.md)."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, SourceError
from ..files.pickles import arrays_of_pickle
from ..files.reading import read_bytes, shown
from ..numeric.arrays import FloatArray
from .numbered_meshes import numbered_files
from .rates import MAX_FPS, MIN_FPS

SUFFIXES = (".npz", ".npy", ".pkl")
Arrays = Mapping[str, NDArray[Any]]
_MAX_FILE = 1 << 30
_MAX_FRAMES = 1_000_000


EXPRESSION, IDENTITY, TRANSLATION, SCALE, VERTICES = "expression", "identity", "translation", "scale", "vertices"
ROOT, NECK, JAW, EYES, LEFT_EYE, RIGHT_EYE = "root", "neck", "jaw", "eyes", "left eye", "right eye"
POSE, BODY, RATE = "pose", "body", "rate"
STATIC_OFFSET, DYNAMIC_OFFSET = "static_offset", "dynamic_offset"
_OF_PERSON = (IDENTITY, STATIC_OFFSET, SCALE, RATE)
"""Kinds that do not change over time."""
_OF_FRAMES = (EXPRESSION, VERTICES, JAW, ROOT)
"""Kinds that have a row for each frame, unless there is only one."""
_MEANS = {
    **dict.fromkeys(("exp", "expr", "expression", "expressions"), EXPRESSION),
    **dict.fromkeys(("shape", "shapes", "beta", "betas", "identity"), IDENTITY),
    **dict.fromkeys(("trans", "transl", "translation", "translations"), TRANSLATION),
    **dict.fromkeys(("verts", "vertice", "vertices"), VERTICES),
    **dict.fromkeys(("global", "root", "orient", "head"), ROOT),
    **dict.fromkeys(("eye", "eyes"), EYES),
    **dict.fromkeys(("leye", "left"), LEFT_EYE),
    **dict.fromkeys(("reye", "right"), RIGHT_EYE),
    **dict.fromkeys(("fps", "rate", "framerate"), RATE),
    **{word: word for word in (NECK, JAW, BODY, SCALE)},
}
"""What words of an array's name mean. They are those of VHAP, NeRSemble, GaussianAvatars, DECA, EMOCA, SMIRK, SMPL-X,
BEAT2, AMASS, and FaceFormer."""
_OVERRULES = {TRANSLATION: {ROOT}, LEFT_EYE: {EYES}, RIGHT_EYE: {EYES}}
"""Meanings that a name may have besides another one, as `global_transl` has."""
_FILLERS = {
    *("flame", "smplx", "smpl", "param", "params", "parameters", "pose", "poses", "code", "coeff", "coeffs"),
    *("coefficients", "rot", "rotation", "rotations", "rotvec", "aa", "axis", "angle", "matrix", "matrices"),
    *("mocap", "frame"),
}
_ENDINGS = re.compile(r"(?<=[a-z])(?:code|pose|params?)$")
"""Fillers that are joined to a word, as in `expcode`."""


def _read_kind(name: str) -> str | None:
    """Return the kind of parameter that an array's name stands for, or None if it is unknown."""
    if name in (STATIC_OFFSET, DYNAMIC_OFFSET):
        return name
    words = re.findall("[a-z]+", re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower())
    words = [word if word in _FILLERS else _ENDINGS.sub("", word) for word in words]
    meanings = {_MEANS.get(word, "") for word in words if word not in _FILLERS}
    for meaning in meanings & _OVERRULES.keys():
        meanings = meanings - _OVERRULES[meaning]
    if not meanings:
        alone = {ROOT: {"rot", "rotation", "rotations"}, POSE: {"pose", "poses"}, EXPRESSION: {"coefficients"}}
        return next((kind for kind, names in alone.items() if names & set(words)), None)
    return (meanings.pop() or None) if len(meanings) == 1 else None


@dataclass(frozen=True)
class FaceParameters:
    """Parameters of a face model in each frame.

    Attributes
    ----------
    arrays : mapping of str to array
        The arrays by their kind, with a row for each frame, or for all.
    names : mapping of str to str
        What the file calls them.
    ignored : tuple of str
        Names of the other arrays.
    """

    arrays: Arrays
    names: Mapping[str, str] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()

    def __contains__(self, kind: str) -> bool:
        return kind in self.arrays

    @property
    def fps(self) -> float | None:
        """Frames per second that the file states, or None."""
        rate = self.arrays.get(RATE, np.empty(0))
        return float(rate.flat[0]) if rate.size == 1 and MIN_FPS <= float(rate.flat[0]) <= MAX_FPS else None

    @property
    def count(self) -> int:
        """Number of frames."""
        known = (self.arrays[kind] for kind in _OF_FRAMES if kind in self.arrays)
        return max((len(value) for value in known if value.ndim > 1), default=1)

    def rows(self, kind: str, width: int) -> FloatArray:
        """Return an array (N, width) with a row for each frame, zeros if it is not given; a single row is repeated, and
        columns that lack are 0. Raises DataError if it has another shape.
        """
        value = self.arrays.get(kind)
        if value is None:
            return np.zeros((self.count, width))
        rows = np.asarray(value, dtype=np.float64).reshape(len(value) if value.ndim > 1 else 1, -1)
        if len(rows) not in (1, self.count) or rows.shape[1] > width:
            raise DataError(
                "{name} has the shape {shape}, for {count} frames of at most {width} values",
                name=shown(self.names[kind]),
                shape=value.shape,
                count=self.count,
                width=width,
            )
        return np.broadcast_to(np.pad(rows, ((0, 0), (0, width - rows.shape[1]))), (self.count, width))

    def turns(self, kind: str) -> FloatArray:
        """Return the rotation vectors (N, joints, 3) of a kind, which may be given as matrices."""
        value = np.asarray(self.arrays[kind], dtype=np.float64)
        frames = len(value) if value.ndim > 1 else 1
        if value.ndim > 2 and value.shape[-2:] == (3, 3) and _are_rotations(value):
            flat = value.reshape(-1, 3, 3)
            value = np.array(
                [cv2.Rodrigues(matrix)[0] if np.isfinite(matrix).all() else [[np.nan]] * 3 for matrix in flat]
            )
        if frames not in (1, self.count) or value.size % (3 * frames):
            raise self.has_unknown_shape(kind)
        turns = value.reshape(frames, -1, 3)
        return np.broadcast_to(turns, (self.count, *turns.shape[1:]))

    def has_unknown_shape(self, kind: str) -> DataError:
        """Return the error that the array of a kind has a shape that means nothing known."""
        name, shape = shown(self.names[kind]), self.arrays[kind].shape
        return DataError("{name} has the shape {shape}, which is unknown", name=name, shape=shape)


def _are_rotations(matrices: FloatArray) -> bool:
    """Whether all matrices (..., 3, 3) are rotations, as far as they are known."""
    known = matrices.reshape(-1, 3, 3)[np.isfinite(matrices).all(axis=(-1, -2)).ravel()]
    return bool(np.allclose(known @ known.transpose(0, 2, 1), np.eye(3), atol=1e-3))


def read_arrays(path: Path, what: Message) -> dict[str, NDArray[Any]]:
    """Return the arrays of numbers in a file by their names; that of an `.npy` file without names has the name "".

    Raises SourceError, which says that the file cannot be read as `what`.
    """
    try:
        if path.suffix.lower() == ".pkl":
            return arrays_of_pickle(read_bytes(path, _MAX_FILE))
        if path.suffix.lower() == ".npy":
            return _read_npy(read_bytes(path, _MAX_FILE))
        with np.load(path, allow_pickle=False) as archive:
            if sum(member.file_size for member in archive.zip.infolist()) > _MAX_FILE:
                raise DataError("it is larger than {limit} MB", limit=_MAX_FILE >> 20)
            arrays = {}
            for name in archive.files:
                with suppress(ValueError):  # an array of objects, which is not read
                    arrays[name] = archive[name]
        return {name: array for name, array in arrays.items() if array.dtype.kind in "biuf"}
    except (OSError, ValueError, EOFError, TypeError, AttributeError, MemoryError, zipfile.BadZipFile) as error:
        raise SourceError("{path} cannot be read as {what}: {error}.", path=path, what=what, error=error) from error


def _read_npy(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the array of an `.npy` file, or those of the dictionary that it contains."""
    stream, form = io.BytesIO(data), cast(Any, np.lib.format)  # its functions have no types
    version = form.read_magic(stream)
    _, _, kind = (form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0)(stream)
    if kind.hasobject:
        return arrays_of_pickle(stream.read())
    array = np.load(io.BytesIO(data), allow_pickle=False)
    return {"": array} if array.dtype.kind in "biuf" else {}


def read_parameters_file(path: Path) -> FaceParameters:
    """Read parameters or vertices: a file with a row for each frame, or numbered files with a frame each.

    A missing number is a row of NaN. Raises SourceError if a file cannot be read or contains no face.
    """
    first = _named(path)
    files = numbered_files(path, SUFFIXES)
    if len(files) < 2 or first.count != 1 or VERTICES in first:
        return first
    frames = {number: _named(file) for number, file in files.items()}
    numbers = range(min(frames), max(frames) + 1)
    if len(numbers) > _MAX_FRAMES:
        raise SourceError("{path} has more than {frames:,} frames.", path=path, frames=_MAX_FRAMES)
    joined = dict(first.arrays)
    for kind, value in first.arrays.items():
        if kind in _OF_PERSON:
            continue
        lost = np.full((1, *np.atleast_2d(value).shape[1:]), np.nan)
        rows = [np.atleast_2d(frames[n].arrays[kind]) if n in frames and kind in frames[n] else lost for n in numbers]
        if any(row.shape != lost.shape for row in rows):
            name = first.names[kind]
            raise SourceError("{path} and the numbered files after it differ in {name}.", path=path, name=shown(name))
        joined[kind] = np.concatenate(rows)
    return FaceParameters(joined, first.names, first.ignored)


def _named(path: Path) -> FaceParameters:
    """Read the parameters in a single file."""
    given = read_arrays(path, Message("parameters of a face"))
    arrays, names = {}, {}
    for name in sorted(given, key=len):  # of rotation and rotation_matrices, the former
        kind = VERTICES if not name else _read_kind(name)
        if kind is not None and kind not in arrays and given[name].size:
            arrays[kind], names[kind] = given[name], name
    if not arrays.keys() & {EXPRESSION, VERTICES, JAW}:
        raise SourceError(
            "{path} contains no expression, such as expr, expression or exp. Choose another file.", path=path
        )
    return FaceParameters(arrays, names, tuple(sorted(given.keys() - set(names.values()))))


def check_shapes(**arrays: tuple[FloatArray, tuple[int, ...]]) -> None:
    """Raise ValueError if an array of the model has another shape than expected, or contains NaN."""
    for name, (array, shape) in arrays.items():
        if array.shape != shape or not np.isfinite(array).all():
            raise DataError(
                "{name} has the shape {shape}, not {expected}", name=name, shape=array.shape, expected=shape
            )
