"""Sequences of numbered mesh files, `.obj` and `.ply`, which have the same vertices in the same order (takes.md)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, SourceError
from ..files.reading import read_bytes, shown
from ..heads.facegen import read_obj
from ..numeric.arrays import FloatArray, IntArray
from .moving_mesh import TO_HEAD, MovingMesh

SUFFIXES = (".obj", ".ply")
_MAX_FILE = 512 << 20
_MAX_FRAMES = 100_000
"""Largest number of frames of a sequence, including those that are missing."""
_NUMBERED = re.compile(r"(.*?)(\d{1,9})")
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
"""Types of numbers in `.ply` files."""
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def numbered_files(path: Path, suffixes: tuple[str, ...] = SUFFIXES) -> dict[int, Path]:
    """Return the numbered files of a sequence by their numbers, in order; none if there is no such sequence.

    `path` is a folder, or the first file: earlier ones are left out. Of several sequences in a folder it is the one
    with most files.
    """
    folder = path if path.is_dir() else path.parent
    if not path.is_dir() and (path.suffix.lower() not in suffixes or _NUMBERED.fullmatch(path.stem) is None):
        return {}
    found: dict[tuple[str, str], dict[int, Path]] = {}
    try:
        content = sorted(folder.iterdir())
    except OSError as error:
        raise SourceError(
            "{path} cannot be read ({reason}). Choose another file.", path=folder, reason=error.strerror
        ) from error
    for file in content:
        named = _NUMBERED.fullmatch(file.stem) if file.suffix.lower() in suffixes else None
        if named is not None:
            found.setdefault((named[1], file.suffix), {})[int(named[2])] = file
    if path.is_dir():
        files = max(found.values(), key=len, default={})
    else:
        named = _NUMBERED.fullmatch(path.stem)
        assert named is not None
        files = found.get((named[1], path.suffix), {})
        files = {number: file for number, file in files.items() if number >= int(named[2])}
    return dict(sorted(files.items()))


def numbers_of(files: dict[int, Path]) -> list[int]:
    """Return the numbers of all frames of a sequence, also of missing ones; raises SourceError if there are too many.

    The numbers may have a constant step.
    """
    numbers = list(files)
    step = int(np.gcd.reduce(np.diff(numbers))) if len(numbers) > 1 else 1
    frames = range(numbers[0], numbers[-1] + 1, step)
    if len(frames) > _MAX_FRAMES:
        raise SourceError(
            "{path} and {last} are {frames:,} frames apart. Number the files consecutively.",
            path=files[numbers[0]],
            last=files[numbers[-1]].name,
            frames=len(frames),
        )
    return list(frames)


@dataclass(frozen=True)
class NumberedMeshes:
    """The frames of a sequence of numbered files as vertices (V, 3), head frame; None for a missing file."""

    files: dict[int, Path]
    count: int

    def __len__(self) -> int:
        return len(numbers_of(self.files))

    def __iter__(self) -> Iterator[FloatArray | None]:
        first = next(iter(self.files.values()))
        for number in numbers_of(self.files):
            path = self.files.get(number)
            places = None if path is None else _read(path)[0]
            if places is not None and len(places) != self.count:
                raise SourceError(
                    "{path} has {count} vertices, and {first} has {others}. Export all frames with the same vertices.",
                    path=path,
                    count=len(places),
                    first=first.name,
                    others=self.count,
                )
            yield places


def read_numbered(path: Path) -> MovingMesh:
    """Read the first of a sequence of meshes; the others are read while they are iterated over.

    `path` is a folder or the first file. Raises SourceError if there is no such sequence, or a file is damaged.
    """
    files = numbered_files(path)
    if len(files) < 2:
        raise SourceError(
            "There are no numbered meshes at {path}, such as face_0001.obj, face_0002.obj. Choose the first of them.",
            path=path,
        )
    first = next(iter(files.values()))
    places, faces = _read(first, faces=True)
    lost = len(numbers_of(files)) - len(files)
    note = Message("Numbers without a file, which are frames without a face: {lost}", lost=lost)
    return MovingMesh(first.name, places, faces, NumberedMeshes(files, len(places)), notes=(note,) if lost else ())


def _read(path: Path, *, faces: bool = False) -> tuple[FloatArray, IntArray]:
    """Read vertices in the head frame and, if they are wanted, the faces of a mesh; SourceError names the file."""
    if faces and path.suffix.lower() == ".obj":
        mesh = read_obj(path)
        return mesh.vertices.astype(np.float64), mesh.faces
    try:
        data = read_bytes(path, _MAX_FILE)
        places, found = _ply(data) if path.suffix.lower() == ".ply" else (_obj_vertices(data), np.empty((0, 3), int))
        if not len(places) or (faces and not len(found)):
            raise DataError("it has no faces" if len(places) else "it has no vertices")
        if not np.isfinite(places).all():
            raise DataError("it has values that are not possible numbers")
        if len(found) and (found.min() < -1 or found.max() >= len(places)):
            raise DataError("a face has a vertex that does not exist")
    except (OSError, ValueError) as error:
        raise SourceError("{path} cannot be read as a mesh: {error}.", path=path, error=error) from error
    return places * TO_HEAD, found


def _obj_vertices(data: bytes) -> FloatArray:
    """Return the vertices (V, 3) of an OBJ file, which may have colours."""
    rows = [line.split() for line in data.splitlines() if line.lstrip()[:2] in (b"v ", b"v\t")]
    return np.array([row[1:4] for row in rows], dtype=np.float64).reshape(-1, 3)


def _ply(data: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3) and faces (F, K), padded with -1, of a PLY file; raises ValueError if it is damaged."""
    header, found, body = data.partition(b"end_header")
    lines = [line.split() for line in header.decode("latin1").splitlines() if line.strip()]
    if not found or lines[0] != ["ply"]:
        raise DataError("it is not a PLY file")
    body = body[body.index(b"\n") + 1 :] if b"\n" in body else b""
    form = next((line[1] for line in lines if line[0] == "format" and len(line) > 1), "")
    if form not in _ORDERS:
        raise DataError("its format is different")
    elements: list[tuple[str, int, list[list[str]]]] = []
    for line in lines:
        if line[0] == "element" and len(line) == 3:
            elements.append((line[1], int(line[2]), []))
        elif line[0] == "property" and elements:
            elements[-1][2].append(line[1:])
    reader = _Words(body) if form == "ascii" else _Bytes(body, _ORDERS[form])
    tables = {name: reader.table(count, properties) for name, count, properties in elements}
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    if not {"x", "y", "z"} <= vertex.keys():
        raise DataError("it has no vertices")
    corners: list[Any] = next((face[name] for name in ("vertex_indices", "vertex_index") if name in face), [])
    width = max(map(len, corners), default=3)
    faces = np.full((len(corners), max(width, 3)), -1, dtype=np.intp)
    for row, corner in zip(faces, corners, strict=True):
        row[: len(corner)] = corner
    return np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64), faces[(faces[:, :3] >= 0).all(axis=1)]


class _Bytes:
    """Reads the tables of a binary PLY file in sequence."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order, self._at = data, order, 0

    def table(self, count: int, properties: list[list[str]]) -> dict[str, Any]:
        """Read `count` rows: arrays of numbers, and lists of arrays, by the names of the properties."""
        if all(len(kind) == 2 for kind in properties):
            row = np.dtype([(name, self._order + _type(kind)) for kind, name in properties])
            values = self._take(row, count)
            return {name: values[name] for _, name in properties}
        columns: dict[str, list[Any]] = {kind[-1]: [] for kind in properties}
        for _ in range(count):
            for kind in properties:
                columns[kind[-1]].append(self._value(kind))
        return columns

    def _value(self, kind: list[str]) -> Any:
        if len(kind) == 2:
            return self._take(np.dtype(self._order + _type(kind[0])), 1)[0]
        length = int(self._take(np.dtype(self._order + _type(kind[1])), 1)[0])
        return self._take(np.dtype(self._order + _type(kind[2])), length)

    def _take(self, kind: np.dtype[Any], count: int) -> NDArray[Any]:
        start, self._at = self._at, self._at + count * kind.itemsize
        if count < 0 or self._at > len(self._data):
            raise DataError("it ends too early")
        return np.frombuffer(self._data, kind, count, start)


class _Words:
    """Reads the tables of a PLY file of text in sequence."""

    def __init__(self, data: bytes) -> None:
        self._lines = iter(line.split() for line in data.splitlines() if line.strip())

    def table(self, count: int, properties: list[list[str]]) -> dict[str, Any]:
        """Read `count` rows, one from each line, as `_Bytes.table` does."""
        columns: dict[str, list[Any]] = {kind[-1]: [] for kind in properties}
        for _ in range(count):
            words = next(self._lines, [])
            at = 0
            for kind in properties:
                length = 1 if len(kind) == 2 else 1 + int(words[at]) if at < len(words) else 1
                if length < 1 or at + length > len(words):
                    raise DataError("it ends too early")
                own = np.array(words[at : at + length], dtype=np.float64)
                columns[kind[-1]].append(own[0] if len(kind) == 2 else own[1:])
                at += length
        return {name: values if values and np.ndim(values[0]) else np.array(values) for name, values in columns.items()}


def _type(name: str) -> str:
    if name not in _TYPES:
        raise DataError("it has numbers of the type {name}", name=shown(name))
    return _TYPES[name]
