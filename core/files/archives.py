"""Safe reading of untrusted numpy archives (`.npz`), with checks of sizes, types and ranges.

`np.load` trusts its input: a header of a hundred bytes can request any amount of memory, and damaged files raise a
dozen kinds of exceptions. Here sizes are checked before anything is allocated, and every problem is a `ValueError`.
"""

from __future__ import annotations

import io
import re
import struct
import sys
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, ModelError
from ..numeric.arrays import FloatArray
from .reading import read_bytes

MAX_BYTES = 16 << 20
"""Largest size in bytes of a file, and of all its members unpacked: several times the largest shipped archive."""
MAX_MEMBERS = 256
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError)
"""Exceptions of `zipfile` for archives that are damaged, encrypted (RuntimeError) or unsupported (its subclass)."""
_MEMBER = b"PK\x01\x02"
_MAGIC = b"\x93NUMPY"
_PREFIXES = {1: struct.Struct("<H"), 2: struct.Struct("<I"), 3: struct.Struct("<I")}
_HEADER = re.compile(
    r"\{'descr': '([<>|=]?[biufU]\d{0,9})', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,200})\), \}\s*"
)
_MAX_HEADER = 4096

Shape = tuple[int | None, ...]


class Archive:
    """The arrays of an archive, read by name with an expected kind and shape.

    All methods raise a ValueError that names the array and the problem. A dimension of None may have any length.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]]) -> None:
        self._arrays = arrays

    def text(self, name: str) -> str:
        """Read a text; an empty one if there is no such array."""
        array = self._arrays.get(name)
        return str(array[()]) if array is not None and array.dtype.kind == "U" and array.ndim == 0 else ""

    def texts(self, name: str) -> tuple[str, ...]:
        """Read a list of distinct texts."""
        array = self._get(name, (None,), "U")
        if len(set(array.tolist())) != len(array):
            raise DataError("{name} contains a duplicate", name=name)
        return tuple(array.tolist())

    def floats(self, name: str, shape: Shape, dtype: type = np.float64) -> FloatArray:
        """Read finite numbers of an expected shape, in which None is a dimension of any length."""
        array = self._get(name, shape, "fiu")
        with np.errstate(over="ignore"):
            out: FloatArray = array.astype(dtype)
        if not np.isfinite(out).all():
            raise DataError("{name} is not finite", name=name)
        return out

    def integers(self, name: str, shape: Shape, low: int, high: int) -> NDArray[np.intp]:
        """Read integers from `low` to `high`, both included, of a shape as for `floats`."""
        array = self._get(name, shape, "iu")
        if array.size and (int(array.min()) < low or int(array.max()) > high):
            raise DataError("{name} is not within {low} to {high}", name=name, low=low, high=high)
        return array.astype(np.intp)

    def flags(self, name: str, shape: Shape) -> NDArray[np.bool_]:
        """Read booleans of a shape as for `floats`."""
        return self._get(name, shape, "b").astype(np.bool_)

    def data(self, name: str) -> bytes:
        """Read bytes, which are stored as an array of uint8."""
        array = self._get(name, (None,), "u")
        if array.dtype != np.uint8:
            raise DataError("{name} has the type {dtype}", name=name, dtype=array.dtype)
        return array.tobytes()

    def _get(self, name: str, shape: Shape, kinds: str) -> NDArray[Any]:
        if (array := self._arrays.get(name)) is None:
            raise DataError("{name} is missing", name=name)
        if array.dtype.kind not in kinds:
            raise DataError("{name} has the type {dtype}", name=name, dtype=array.dtype)
        fits = array.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = str(tuple("any" if want is None else want for want in shape)).replace("'", "")
            raise DataError("{name} has the shape {shape}, not {wanted}", name=name, shape=array.shape, wanted=wanted)
        return array


def read_archive(data: bytes, limit: int = MAX_BYTES) -> Archive:
    """Read an archive of numbers and texts: a zip file of `.npy` members, stored or deflated.

    Raises ValueError if it is anything else, is damaged, or would unpack to more than `limit` bytes.
    """
    if data.count(_MEMBER) > MAX_MEMBERS:  # before `zipfile` creates an object for each
        raise DataError("it has more than {max_members} members", max_members=MAX_MEMBERS)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            _check_members(members, limit)
            return Archive({m.filename.removesuffix(".npy"): _array(m, archive) for m in members})
    except _DAMAGE as error:
        raise DataError("its archive is damaged") from error


@contextmanager
def open_shipped(path: Path, form: str) -> Iterator[Archive]:
    """Open an archive of the assets whose array "format" is `form`, and raise what is wrong with it as a ModelError.

    Files may be missing, damaged or of a different version. A ValueError within the context becomes a ModelError, too.
    """
    try:
        archive = read_archive(read_bytes(path, MAX_BYTES))
        if archive.text("format") != form:
            raise DataError("its version is different")
        yield archive
    except FileNotFoundError as error:
        raise ModelError("The model {path} is missing. Reinstall Facemime.", path=path) from error
    except (OSError, ValueError) as error:
        raise ModelError(
            "The model {path} is damaged ({error}). Reinstall Facemime.", path=path, error=error
        ) from error


def _check_members(members: list[zipfile.ZipInfo], limit: int) -> None:
    if (total := sum(member.file_size for member in members)) > limit:
        raise DataError("it unpacks to {total} MB, more than {limit} MB", total=total >> 20, limit=limit >> 20)
    for member in members:
        if member.compress_type not in _METHODS or member.flag_bits & _ENCRYPTED:
            raise DataError("it is encrypted, or compressed in a way that numpy does not use")
        if not member.filename.endswith(".npy"):
            raise DataError("a member is not a numpy array")
    if len({member.filename for member in members}) != len(members):
        raise DataError("two members have the same name")


def _array(member: zipfile.ZipInfo, archive: zipfile.ZipFile) -> NDArray[Any]:
    with archive.open(member) as stream:
        content = stream.read(member.file_size)
        if len(content) != member.file_size or stream.read(1):
            raise DataError("the length of a member differs from the archive's directory")
    return _array_of(content)


def _array_of(content: bytes) -> NDArray[Any]:
    """Parse an `.npy` file, comparing the stated size with the actual one before allocating."""
    version = content[len(_MAGIC)] if len(content) > len(_MAGIC) + 2 else 0
    if not content.startswith(_MAGIC) or version not in _PREFIXES:
        raise DataError("a member is not a numpy array")
    prefix = _PREFIXES[version]
    start = len(_MAGIC) + 2 + prefix.size
    (length,) = prefix.unpack_from(content, len(_MAGIC) + 2)
    header = content[start : start + min(length, _MAX_HEADER)].decode("latin-1")
    found = _HEADER.fullmatch(header)
    if found is None:
        raise DataError("a member's header is damaged")
    try:
        dtype = np.dtype(found[1])
    except TypeError as error:
        raise DataError("a member has the unknown type {found}", found=found[1]) from error
    shape = tuple(int(side) for side in found[3].split(",") if side.strip())
    count = prod(shape)
    if (
        not dtype.itemsize
        or count * dtype.itemsize != len(content) - start - length
        or any(side > len(content) for side in shape)
    ):
        raise DataError("the length of a member differs from its header")
    flat = np.frombuffer(content, dtype, count, start + length) if count else np.empty(0, dtype)
    if dtype.kind == "U" and count and int(flat.view(f"{dtype.byteorder}u4").max()) > sys.maxunicode:
        raise DataError("a member has invalid characters")  # on which numpy would raise a SystemError
    return flat.reshape(shape, order="F" if found[2] == "True" else "C")
