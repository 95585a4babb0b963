"""The format of `.facetake` files: independent chunks, each with a checksum (takes.md).

Numbers are stored as multiples of a step far below the tracker's noise. A chunk contains the differences of these
multiples from frame to frame, sorted by the significance of their bytes and deflated. This is smaller than any
floating-point format, and saving a stored value again does not change it.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..face.landmarks import N_LANDMARKS
from ..face.names import N_ACTIONS, N_COEFFICIENTS
from ..files.reading import parse_json
from ..numeric.arrays import FloatArray
from .take import Take

FORMAT_VERSION = 4
MARKER = b"\x8bFTAKE\r\n"
START, FRAMES, END = b"S", b"F", b"E"
"""Kinds of chunks: the description of the take, its frames, and the description again at the end."""
HEADER = struct.Struct("<8sBcHIIII")
"""Marker, version, kind, frames in the chunk, frames before it, bytes of content, checksums of content and header."""
MAX_FRAMES = 256
MAX_MODES = 512
MAX_CONTENT = 1 << 22
_MAX_SIDE = 1 << 14
"""Largest side of an image in pixels."""
_UNKNOWN = np.int64(-(2**31))
_MAX_MULTIPLE = 2**31 - 1

_POSE_STEPS = (2.0**-10, 2.0**-16, 2.0**-16, 2.0**-16, 2.0**-7, 2.0**-7)
Column = tuple[str, tuple[int, ...], float | tuple[float, ...]]
LAYOUT: tuple[Column, ...] = (
    ("found", (), 1.0),
    ("confidence", (), 2.0**-10),
    ("pose", (6,), _POSE_STEPS),
    ("shape", (N_LANDMARKS, 3), 2.0**-13),
    ("landmarks", (N_LANDMARKS, 2), 2.0**-5),
    ("landmark_confidence", (N_LANDMARKS,), 2.0**-8),
    ("pupils", (2, 2), 2.0**-6),
    ("gaze", (2,), 2.0**-13),
    ("vergence", (), 2.0**-13),
    ("actions", (N_ACTIONS,), 2.0**-8),
    ("teeth", (), 2.0**-8),
    ("coefficients", (N_COEFFICIENTS,), 2.0**-16),
    ("shape_params", (-1,), 2.0**-13),
)
"""Name, shape and step of the columns of a frame, without its time. Values change by half a step at most. The shape
parameters come last, as their number depends on the model."""
_SINCE = {"vergence": 2, "actions": 2, "coefficients": 3, "teeth": 4}
"""Version of the format that introduced a column; other columns are in all versions."""


@dataclass(frozen=True)
class Chunk:
    """An intact chunk.

    Attributes
    ----------
    kind : bytes
        `START`, `FRAMES` or `END`.
    count, first : int
        How many frames are in the chunk, and the number of the first one.
    version : int
        Version of the format.
    """

    kind: bytes
    count: int
    first: int
    content: bytes
    version: int = FORMAT_VERSION


@dataclass(frozen=True)
class Damage:
    """Bytes that are not an intact chunk; `end` says that nothing intact follows."""

    end: bool


class NewerFormatError(ValueError):
    """The file was written by a newer version of Facemime."""


def chunk_bytes(kind: bytes, content: bytes, *, count: int = 0, first: int = 0) -> bytes:
    """Serialise a chunk of a kind (`START`, `FRAMES` or `END`) with `count` frames from number `first`."""
    fields = (MARKER, FORMAT_VERSION, kind, count, first, len(content), zlib.crc32(content))
    head = HEADER.pack(*fields, 0)[:-4]
    return head + struct.pack("<I", zlib.crc32(head)) + content


def chunks_in(data: bytes) -> Iterator[Chunk | Damage]:
    """Iterate over the intact chunks of a file, with a `Damage` in place of anything else.

    After damage the next marker is sought, also within the alleged content of a broken chunk, because a length is not
    trusted without its checksum. The work is bounded by the size of the file. Raises ValueError if so many chunks are
    broken that the file must have been made to keep a reader busy, and NewerFormatError if an intact header states a
    later version.
    """
    at, patience = 0, 4 * len(data) + MAX_CONTENT
    while 0 <= at < len(data):
        chunk, cost = _chunk_at(data, at)
        if chunk is not None:
            yield chunk
            at += HEADER.size + len(chunk.content)
            continue
        patience -= cost
        if patience < 0:
            raise DataError("its chunks overlap")
        at = _next_chunk(data, at + 1)
        yield Damage(end=at < 0)


def _next_chunk(data: bytes, at: int) -> int:
    """Return the start of the next header with a valid checksum, or -1."""
    at = data.find(MARKER, at)
    while at >= 0 and _header_at(data, at) is None:
        at = data.find(MARKER, at + 1)
    return at


def _header_at(data: bytes, at: int) -> tuple[Any, ...] | None:
    head = data[at : at + HEADER.size]
    if len(head) < HEADER.size:
        return None
    fields = HEADER.unpack(head)
    return fields if fields[0] == MARKER and zlib.crc32(head[:-4]) == fields[-1] else None


def _chunk_at(data: bytes, at: int) -> tuple[Chunk | None, int]:
    """Return the chunk at byte `at`, or None if it is broken, and the number of bytes that were read to find out."""
    if (fields := _header_at(data, at)) is None:
        return None, 0
    _, version, kind, count, first, length, checksum, _ = fields
    if version > FORMAT_VERSION:
        raise NewerFormatError
    start = at + HEADER.size
    if length > min(MAX_CONTENT, len(data) - start) or count > MAX_FRAMES:
        return None, 0
    content = data[start : start + length]
    return (Chunk(kind, count, first, content, version) if zlib.crc32(content) == checksum else None), length


def info_content(info: dict[str, Any], frames: int) -> bytes:
    """Serialise `Take.info`, in which NaN and infinity become null, with the number of frames."""
    return json.dumps({"info": _plain(info), "frames": frames}, allow_nan=False).encode()


def info_of(content: bytes) -> tuple[dict[str, Any], int]:
    """Parse the result of `info_content` without invalid entries; ValueError if it is anything else."""
    data = parse_json(content)
    if not isinstance(data, dict) or not isinstance(data.get("info"), dict) or not isinstance(data.get("frames"), int):
        raise DataError("its description is missing")
    info = {key: value for key, value in data["info"].items() if key not in _CHECKS or _CHECKS[key](value)}
    return info, data["frames"]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and 0 < value < 1e6


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < 1e9


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) < 4096


def _is_spans(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(span, list) and len(span) == 2 and all(map(_is_time, span)) for span in value
    )


def _is_side(value: Any) -> bool:
    return isinstance(value, int) and 0 < value <= _MAX_SIDE


_CHECKS: dict[str, Callable[[Any], bool]] = {
    "fps": _is_number,
    "image_size": lambda value: isinstance(value, list) and len(value) == 2 and all(map(_is_side, value)),
    "calibration": lambda value: isinstance(value, dict),
    "bridged": _is_spans,
    "punched_in": _is_spans,
    "offset": _is_time,
    **dict.fromkeys(("source", "model", "clock", "started", "recovered", "reference_video", "sound"), _is_text),
}
"""Checks of the entries that are used in computations, as a file may contain anything."""


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not isfinite(value) else value


def frames_content(take: Take) -> bytes:
    """Serialise at most `MAX_FRAMES` frames. Frames whose pose or shape is not finite are stored as lost."""
    steps = _steps(LAYOUT, take.shape_params.shape[1])
    found = take.found & np.isfinite(take.shape).all(axis=(1, 2)) & np.isfinite(take.pose).all(axis=1)
    values = {name: getattr(take, name) for name, _, _ in LAYOUT} | {"found": found}
    table = np.concatenate([values[name].reshape(len(take), -1).astype(np.float64) for name, _, _ in LAYOUT], axis=1)
    known = np.isfinite(table)
    multiples = np.clip(np.rint(np.where(known, table, 0.0) / steps), -_MAX_MULTIPLE, _MAX_MULTIPLE).astype(np.int64)
    return take.times.astype("<f8").tobytes() + _pack(np.where(known, multiples, _UNKNOWN))


def frames_of(content: bytes, count: int, version: int = FORMAT_VERSION) -> Take:
    """Parse the result of `frames_content` with `count` frames; raises ValueError if the content is anything else.

    Columns that earlier versions of the format lack are unknown.
    """
    times = np.frombuffer(content[: 8 * count], "<f8")
    layout = [column for column in LAYOUT if _SINCE.get(column[0], 1) <= version]
    fixed = int(sum(np.prod(shape) for _, shape, _ in layout[:-1]))
    multiples = _unpack(content[8 * count :], count, fixed)
    table = multiples * _steps(layout, multiples.shape[1] - fixed)
    table[multiples == _UNKNOWN] = np.nan
    arrays: dict[str, Any] = {
        name: np.full((count, *shape), np.nan) for name, shape, _ in LAYOUT if _SINCE.get(name, 1) > version
    }
    column = 0
    for name, shape, _ in layout:
        width = multiples.shape[1] - column if shape == (-1,) else int(np.prod(shape))
        arrays[name] = table[:, column : column + width].reshape(count, *(shape if width else (0,)))
        column += width
    dtypes = {"found": np.bool_, "pose": np.float64}
    arrays = {name: array.astype(dtypes.get(name, np.float32)) for name, array in arrays.items()}
    return Take(times=times.astype(np.float64), **arrays)


def _steps(layout: Sequence[Column], modes: int) -> FloatArray:
    """Step of each column, (columns,), for a model with `modes` modes."""
    widths = [modes if shape == (-1,) else int(np.prod(shape)) for _, shape, _ in layout]
    return np.concatenate([np.broadcast_to(step, width) for (_, _, step), width in zip(layout, widths, strict=True)])


def _pack(multiples: NDArray[np.int64]) -> bytes:
    """Deflate (N, D) 32-bit integers, as described in takes.md."""
    change = np.diff(multiples, axis=0, prepend=0).astype(np.int32)  # overflow wraps, and wraps back when read
    folded = (change << 1) ^ (change >> 31)
    planes = np.ascontiguousarray(folded.T).astype("<i4").view(np.uint8).reshape(-1, 4).T
    return zlib.compress(planes.tobytes(), 6)


def _unpack(deflated: bytes, count: int, fixed: int) -> NDArray[np.int32]:
    """Reverse `_pack`, with `fixed` columns besides the modes."""
    limit = 4 * count * (fixed + MAX_MODES)
    stream = zlib.decompressobj()
    try:
        raw = stream.decompress(deflated, limit + 1)
    except zlib.error as error:
        raise DataError("its frames cannot be unpacked: {error}", error=error) from error
    columns, rest = divmod(len(raw), 4 * count) if count else (0, 1)
    if rest or not fixed <= columns <= fixed + MAX_MODES or not stream.eof:
        raise DataError("{raw} bytes are not {count} frames", raw=len(raw), count=count)
    folded = np.frombuffer(raw, np.uint8).reshape(4, -1).T.copy().view("<u4").reshape(columns, count)
    change = (folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)
    return np.ascontiguousarray(np.cumsum(change, axis=1, dtype=np.int32).T)  # wraps as in `_pack`
