"""FaceGen heads: `.tri` (mesh with difference and statistical morphs), `.egm` (modes of face space), and OBJ files.

All three list vertices in the same order, on which morphs depend, so nothing is merged or sorted. FaceGen's axes are x
to the viewer's right, y up and z towards the viewer; results are in the head frame (y down, z away). Both are in
millimetres.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, SourceError
from ..files.reading import read_bytes, shown

_TO_HEAD = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_MAX_COUNT = 50_000_000
"""Largest count in a valid file."""
_MAX_FILE = 256 << 20
_MAX_MORPHS = 1000
"""Largest number of morphs in a file. An empty statistical morph takes 12 bytes in the file, and as many in memory per
vertex."""
_MAX_MORPH_BYTES = 256 << 20
"""Largest size of a file's morphs in memory."""
_MAX_COORDINATE = 1e9
"""Largest coordinate in millimetres; squares of larger ones might not be finite."""


@dataclass(frozen=True)
class FaceGenMesh:
    """A mesh in the head frame and millimetres.

    Attributes
    ----------
    vertices, faces, uv : (V, 3) float32, (F, 4) int32, (F, 4, 2) float32
        As in `built_in.Head`; `uv` may be None.
    morphs : tuple of (str, (V, 3) float32)
        Name and displacement of each difference and statistical morph.
    labels : dict of str to int
        Named vertices, and the vertices nearest to named points on faces.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32] | None
    morphs: tuple[tuple[str, NDArray[np.float32]], ...]
    labels: dict[str, int]


def read_tri(path: Path) -> FaceGenMesh:
    """Read a `.tri` file of version 003.

    Raises SourceError, which states the byte, if the file is missing, encrypted, of a different version or damaged.
    """
    reader = _Reader(path, b"FRTRI", b"003")
    names = ("V", "T", "Q", "LV", "LS", "X", "ext", "Md", "Ms", "K")
    count = dict(zip(names, (reader.count(name) for name in names), strict=True))
    reader.skip(16)
    reader.check_morphs(count["Md"] + count["Ms"], count["V"])
    vertices = reader.vectors(count["V"], Message("the vertices"))
    targets = reader.vectors(count["K"], Message("vertices of the statistical morphs"))
    triangles = reader.indices((count["T"], 3), count["V"], Message("the triangles"))
    quads = reader.indices((count["Q"], 4), count["V"], Message("the quads"))
    wide = bool(count["ext"] & 2)
    labels = {}
    for _ in range(count["LV"]):
        vertex = reader.indices((1,), count["V"], Message("a labelled vertex"))[0]
        labels[reader.label(wide)] = int(vertex)
    # Points on a face, of which a quad has two: the triangles at its second and at its fourth corner.
    halves = np.concatenate([triangles, quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)])
    for _ in range(count["LS"]):
        face = reader.indices((1,), len(halves), Message("a labelled point"))[0]
        shares = reader.array("<f4", (3,), Message("a labelled point"))
        labels[reader.label(wide)] = int(halves[face][shares.argmax()])
    uv = _tri_uv(reader, count, triangles, quads)
    morphs = [(reader.label(wide), reader.differences(count["V"])) for _ in range(count["Md"])]
    used = 0
    for _ in range(count["Ms"]):
        name, moved = reader.label(wide), reader.count(Message("vertices of a statistical morph"))
        rows = reader.indices((moved,), count["V"], Message("vertices of the morph {name}", name=shown(name)))
        if used + moved > count["K"]:
            reader.fail(Message("more vertices of statistical morphs than the header states"))
        offsets = np.zeros_like(vertices)
        offsets[rows] = targets[used : used + moved] - vertices[rows]
        morphs.append((name, offsets))
        used += moved
    reader.end()
    faces = np.concatenate([np.pad(triangles, ((0, 0), (0, 1)), constant_values=-1), quads])
    return _sound(path, FaceGenMesh(vertices, faces, uv, tuple(morphs), labels))


def read_egm(path: Path, mesh: FaceGenMesh) -> tuple[tuple[str, NDArray[np.float32]], ...]:
    """Read the modes of a mesh from an `.egm` file of version 002: their names, and displacements (V, 3) at one unit.

    Raises SourceError as `read_tri` does, and if the file belongs to a mesh with another number of vertices.
    """
    reader = _Reader(path, b"FREGM", b"002")
    vertices, symmetric = reader.count(Message("the vertices")), reader.count(Message("the symmetric modes"))
    asymmetric = reader.count(Message("the asymmetric modes"))
    reader.skip(44)
    if vertices < len(mesh.vertices):
        raise SourceError(
            "{path} belongs to a mesh with {vertices} vertices; this one has {own}. Use its own .egm.",
            path=path,
            vertices=vertices,
            own=len(mesh.vertices),
        )
    reader.check_morphs(symmetric + asymmetric, vertices)
    names = [f"Symmetric {i + 1:02d}" for i in range(symmetric)]
    names += [f"Asymmetric {i + 1:02d}" for i in range(asymmetric)]
    modes = tuple((name, reader.differences(vertices)[: len(mesh.vertices)]) for name in names)
    reader.end()
    return modes


def read_obj(path: Path) -> FaceGenMesh:
    """Read vertices, faces and texture coordinates of a Wavefront OBJ in the order of the file, and ignore the rest.

    Raises SourceError if the file is missing, or a line cannot be parsed; the message states the line.
    """
    vertices: list[list[float]] = []
    texture: list[list[float]] = []
    corners: list[list[tuple[int, int]]] = []
    number = 0
    try:
        for line in read_bytes(path, _MAX_FILE).decode("utf-8", "replace").splitlines():
            number += 1
            kind, _, rest = line.strip().partition(" ")
            if kind == "v":
                vertices.append(_numbers(rest, 3))
            elif kind == "vt":
                texture.append(_numbers(rest, 2))
            elif kind == "f":
                corners += _fan([_corner(text, len(vertices), len(texture)) for text in rest.split()])
        places = np.array(vertices, dtype=np.float32).reshape(len(vertices), 3)
        coordinates = np.array(texture, dtype=np.float32).reshape(len(texture), 2)
    except OSError as error:
        raise SourceError(
            "{path} cannot be read ({reason}). Choose another file.", path=path, reason=error.strerror
        ) from error
    except ValueError as error:
        where = Message(" at line {number}", number=number) if number else ""
        raise SourceError(
            "{path} is damaged{where} ({error}). Export it again.", path=path, where=where, error=error
        ) from error
    if not len(places) or not corners:
        raise SourceError("{path} contains no mesh. Export it again, with its faces.", path=path)
    faces = np.array([[vertex for vertex, _ in face] for face in corners], dtype=np.int32)
    of_texture = np.array([[index for _, index in face] for face in corners])
    has_uv = len(texture) > 0 and bool((of_texture[faces >= 0] >= 0).all())
    uv = np.where((faces >= 0)[..., None], coordinates[np.maximum(of_texture, 0)], 0.0) if has_uv else None
    mesh = FaceGenMesh(places * _TO_HEAD, faces, None if uv is None else uv.astype(np.float32), (), {})
    return _sound(path, mesh)


def _sound(path: Path, mesh: FaceGenMesh) -> FaceGenMesh:
    """Remove degenerate and duplicate faces; SourceError if no face with an area remains.

    Blender accepts such faces, but its Subdivide then crashes or never ends.
    """
    faces = mesh.faces.copy()
    ordered = np.sort(faces, axis=1)
    for row in np.flatnonzero(((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any(axis=1)).tolist():
        corners = [corner for corner in faces[row].tolist() if corner >= 0]
        distinct = [place for place, corner in enumerate(corners) if corner != corners[place - 1]]
        if len(distinct) == 3 == len({corners[place] for place in distinct}):  # a quad with one side of length 0
            faces[row] = [*(corners[place] for place in distinct), -1]
            if mesh.uv is not None:
                mesh.uv[row, :3] = mesh.uv[row, distinct]
        else:
            faces[row] = -1
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    kept = np.sort(first)
    kept = kept[faces[kept, 2] >= 0]
    corners = mesh.vertices.astype(np.float64)[faces[kept]]
    with_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not with_area.any():
        raise SourceError("{path} contains no mesh: none of its faces has an area. Export it again.", path=path)
    uv = None if mesh.uv is None else mesh.uv[kept]
    return replace(mesh, faces=faces[kept], uv=uv)


def _numbers(text: str, count: int) -> list[float]:
    numbers = [float(value) for value in text.split()[:count]]
    if len(numbers) < count or not all(abs(number) <= _MAX_COORDINATE for number in numbers):
        raise DataError("{text} instead of {count} numbers", text=shown(text.strip()), count=count)
    return numbers


def _corner(text: str, vertices: int, texture: int) -> tuple[int, int]:
    """Parse a corner `v`, `v/vt`, `v//vn` or `v/vt/vn` as vertex and texture coordinate, or -1."""
    parts = text.split("/")
    vertex = _from_one(int(parts[0]), vertices)
    return vertex, _from_one(int(parts[1]), texture) if len(parts) > 1 and parts[1] else -1


def _from_one(index: int, count: int) -> int:
    """Convert an OBJ index, which counts from 1, or backwards from the last."""
    place = index - 1 if index > 0 else count + index
    if not 0 <= place < count:
        raise DataError("index {index} is out of range, as there are {count}", index=shown(index), count=count)
    return place


def _fan(face: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """Pad triangles and quads, and split larger polygons into a fan of triangles."""
    if len(face) < 3:
        raise DataError("a face with fewer than three corners")
    if len(face) <= 4:
        return [face + [(-1, -1)] * (4 - len(face))]
    return [[face[0], face[i], face[i + 1], (-1, -1)] for i in range(1, len(face) - 1)]


def _tri_uv(
    reader: _Reader, count: dict[str, int], triangles: NDArray[np.int32], quads: NDArray[np.int32]
) -> NDArray[np.float32] | None:
    """Read texture coordinates, (F, 4, 2), from a list with indices per face, or from one per vertex."""
    if count["X"]:
        table = reader.array("<f4", (count["X"], 2), Message("texture coordinates"))
        of_triangles = reader.indices((count["T"], 3), count["X"], Message("texture of the triangles"))
        of_quads = reader.indices((count["Q"], 4), count["X"], Message("texture of the quads"))
    elif count["ext"] & 1:
        table = reader.array("<f4", (count["V"], 2), Message("texture coordinates"))
        of_triangles, of_quads = triangles, quads
    else:
        return None
    uv = np.zeros((len(triangles) + len(quads), 4, 2), dtype=np.float32)
    uv[: len(triangles), :3] = table[of_triangles]
    uv[len(triangles) :] = table[of_quads]
    return uv


class _Reader:
    """Reads little-endian values in sequence. Errors state the position in the file."""

    def __init__(self, path: Path, kind: bytes, version: bytes) -> None:
        self.path = path
        try:
            self._data = read_bytes(path, _MAX_FILE)
        except OSError as error:
            raise SourceError(
                "{path} cannot be read ({reason}). Choose another file.", path=path, reason=error.strerror
            ) from error
        except ValueError as error:
            raise SourceError("{path} cannot be read: {error}. Choose another file.", path=path, error=error) from error
        if self._data[:5] != kind:
            raise SourceError(
                "{path} is not a {kind} file of FaceGen (byte 0). Choose another file.", path=path, kind=kind.decode()
            )
        if self._data[5:8] != version:
            found = self._data[5:8].decode("ascii", "replace")
            raise SourceError(
                "{path} has version {found} (byte 5), not {version}. Export it again, unencrypted.",
                path=path,
                found=found,
                version=version.decode(),
            )
        self._at = 8

    def fail(self, what: str) -> None:
        """Raise a SourceError at the current position."""
        raise SourceError(
            "{path} is damaged at byte {at}: {what}. Export it again.", path=self.path, at=self._at, what=what
        )

    def end(self) -> None:
        """Check that nothing follows."""
        if self._at != len(self._data):
            self.fail(Message("{count} bytes follow the end", count=len(self._data) - self._at))

    def skip(self, size: int) -> None:
        """Skip `size` bytes."""
        self._need(size, Message("reserved bytes"))
        self._at += size

    def count(self, what: str) -> int:
        """Read a 32-bit count."""
        self._need(4, Message("the number of {what}", what=what))
        (value,) = struct.unpack_from("<i", self._data, self._at)
        if not 0 <= value <= _MAX_COUNT:
            self.fail(Message("{value} as the number of {what}", value=value, what=what))
        self._at += 4
        return int(value)

    def check_morphs(self, morphs: int, vertices: int) -> None:
        """Fail if no head has that many morphs, before memory is allocated."""
        if morphs > _MAX_MORPHS or 12 * morphs * vertices > _MAX_MORPH_BYTES:
            self.fail(
                Message(
                    "{morphs} morphs of {vertices} vertices, more than any head has", morphs=morphs, vertices=vertices
                )
            )

    def array(self, dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
        """Read an array of `dtype`."""
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        self._need(size, what)
        values = np.frombuffer(self._data, dtype, int(np.prod(shape)), self._at).reshape(shape)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            self.fail(Message("{what} that are not finite", what=what))
        self._at += size
        return values

    def vectors(self, count: int, what: str) -> NDArray[np.float32]:
        """Read vectors (count, 3), converted to the head frame."""
        start = self._at
        values = self.array("<f4", (count, 3), what)
        if np.abs(values).max(initial=0.0) > _MAX_COORDINATE:
            self._at = start
            self.fail(Message("{what} that are too far away", what=what))
        return np.asarray(values * _TO_HEAD, dtype=np.float32)

    def indices(self, shape: tuple[int, ...], limit: int, what: str) -> NDArray[np.int32]:
        """Read indices below `limit`."""
        start = self._at
        values = self.array("<i4", shape, what)
        if values.size and (values.min() < 0 or values.max() >= limit):
            self._at = start
            self.fail(Message("{what} with an index outside 0 to {last}", what=what, last=limit - 1))
        return values.astype(np.int32)

    def differences(self, count: int) -> NDArray[np.float32]:
        """Read a scale and 16-bit displacements, (count, 3)."""
        scale = float(self.array("<f4", (1,), Message("the scale of a morph"))[0])
        if abs(scale) > _MAX_COORDINATE / 2**15:
            self.fail(Message("a morph that moves too far"))
        return np.asarray(self.array("<i2", (count, 3), Message("a morph")) * (scale * _TO_HEAD), dtype=np.float32)

    def label(self, wide: bool) -> str:
        """Read a text that is preceded by its length and ends with a null."""
        length = self.count(Message("letters of a label")) * (2 if wide else 1)
        self._need(length, Message("a label"))
        text = self._data[self._at : self._at + length].decode("utf-16-le" if wide else "latin-1", "replace")
        self._at += length
        return text.partition("\0")[0]

    def _need(self, size: int, what: str) -> None:
        if self._at + size > len(self._data):
            self.fail(Message("the file ends within {what}", what=what))
