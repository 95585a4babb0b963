"""The bytes of a `.facetake`: chunks that stand for themselves, each with its checksum (docs/takes.md).

Every number is a multiple of a step that is far below the tracker's noise. A chunk holds the differences of those
multiples from frame to frame, sorted by the significance of their bytes and deflated: no format of floating-point
numbers is as small, and a value that was stored once is stored again without any further loss.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..landmarks import N_LANDMARKS
from ..reading import parse_json
from .take import Take

FORMAT_VERSION = 1
MARKER = b"\x8bFTAKE\r\n"
START, FRAMES, END = b"S", b"F", b"E"
"""The kinds of chunks: how the take was made, its frames, and the same as the first once more where it ends."""
HEADER = struct.Struct("<8sBcHIIII")
"""Marker, version, kind, frames in the chunk, frames before it, bytes of content, checksum of content and of header."""
MAX_FRAMES = 256
MAX_MODES = 512
MAX_CONTENT = 1 << 22
_LARGEST_SIDE = 1 << 14
"""Pixels, of a picture."""
_UNKNOWN = np.int64(-(2**31))
_LARGEST = 2**31 - 1

_POSE_STEPS = (2.0**-10, 2.0**-16, 2.0**-16, 2.0**-16, 2.0**-7, 2.0**-7)
LAYOUT: tuple[tuple[str, tuple[int, ...], float | tuple[float, ...]], ...] = (
    ("found", (), 1.0),
    ("confidence", (), 2.0**-10),
    ("pose", (6,), _POSE_STEPS),
    ("shape", (N_LANDMARKS, 3), 2.0**-13),
    ("landmarks", (N_LANDMARKS, 2), 2.0**-5),
    ("landmark_confidence", (N_LANDMARKS,), 2.0**-8),
    ("pupils", (2, 2), 2.0**-6),
    ("gaze", (2,), 2.0**-13),
    ("shape_params", (-1,), 2.0**-13),
)
"""Name, shape and step of what a frame holds beside its time, in the order of the columns; a number loses half a step
at most. The shape parameters come last, as their number is the model's."""
_FIXED = int(sum(np.prod(shape) for _, shape, _ in LAYOUT[:-1]))


@dataclass(frozen=True)
class Chunk:
    """One intact chunk: `kind`, `count` frames from frame number `first` on, and the content."""

    kind: bytes
    count: int
    first: int
    content: bytes


@dataclass(frozen=True)
class Damage:
    """Bytes that are no intact chunk; `end` is whether nothing intact follows them."""

    end: bool


class NewerFormatError(ValueError):
    """The file was written by a version of Facemime that knows more than this one."""


def chunk_bytes(kind: bytes, content: bytes, *, count: int = 0, first: int = 0) -> bytes:
    """A chunk as it stands in the file."""
    fields = (MARKER, FORMAT_VERSION, kind, count, first, len(content), zlib.crc32(content))
    head = HEADER.pack(*fields, 0)[:-4]
    return head + struct.pack("<I", zlib.crc32(head)) + content


def chunks_in(data: bytes) -> Iterator[Chunk | Damage]:
    """The intact chunks of a file's bytes in their order, with one `Damage` wherever something else stands.

    Raises
    ------
    NewerFormatError
        Where an intact header states a later version.
    ValueError
        Where so many chunks are broken that the file was made to keep a reader busy.

    Notes
    -----
    After damage the next marker is looked for, within what a broken chunk claims as its content too, so that a length
    is never trusted further than its checksum. The work is bounded by the file's size.
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
            raise ValueError("its chunks overlap")
        at = _next_chunk(data, at + 1)
        yield Damage(end=at < 0)


def _next_chunk(data: bytes, at: int) -> int:
    """Where the next header with a right checksum starts, -1 where none does."""
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
    """The chunk that starts at byte `at`, None where it is broken, and the bytes that were looked at to know it."""
    if (fields := _header_at(data, at)) is None:
        return None, 0
    _, version, kind, count, first, length, checksum, _ = fields
    if version > FORMAT_VERSION:
        raise NewerFormatError
    start = at + HEADER.size
    if length > min(MAX_CONTENT, len(data) - start) or count > MAX_FRAMES:
        return None, 0
    content = data[start : start + length]
    return (Chunk(kind, count, first, content) if zlib.crc32(content) == checksum else None), length


def info_content(info: dict[str, Any], frames: int) -> bytes:
    """The content of a chunk that tells how the take was made; numbers that are none become null."""
    return json.dumps({"info": _plain(info), "frames": frames}, allow_nan=False).encode()


def info_of(content: bytes) -> tuple[dict[str, Any], int]:
    """What `info_content` was given, without what cannot be; ValueError where it is something else."""
    told = parse_json(content)
    if not isinstance(told, dict) or not isinstance(told.get("info"), dict) or not isinstance(told.get("frames"), int):
        raise ValueError("it does not tell how it was made")
    info = {key: value for key, value in told["info"].items() if key not in _KINDS or _KINDS[key](value)}
    return info, told["frames"]


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
    return isinstance(value, int) and 0 < value <= _LARGEST_SIDE


_KINDS: dict[str, Callable[[Any], bool]] = {
    "fps": _is_number,
    "image_size": lambda value: isinstance(value, list) and len(value) == 2 and all(map(_is_side, value)),
    "calibration": lambda value: isinstance(value, dict),
    "bridged": _is_spans,
    "punched_in": _is_spans,
    "offset": _is_time,
    **dict.fromkeys(("source", "model", "clock", "started", "recovered", "reference_video", "sound"), _is_text),
}
"""Of what is computed with, what it may be: a file may say anything."""


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not isfinite(value) else value


def frames_content(take: Take) -> bytes:
    """The content of a chunk of at most `MAX_FRAMES` frames. A frame without numbers is one without a face."""
    steps = _steps(take.shape_params.shape[1])
    found = take.found & np.isfinite(take.shape).all(axis=(1, 2)) & np.isfinite(take.pose).all(axis=1)
    values = {name: getattr(take, name) for name, _, _ in LAYOUT} | {"found": found}
    table = np.concatenate([values[name].reshape(len(take), -1).astype(np.float64) for name, _, _ in LAYOUT], axis=1)
    known = np.isfinite(table)
    multiples = np.clip(np.rint(np.where(known, table, 0.0) / steps), -_LARGEST, _LARGEST).astype(np.int64)
    return take.times.astype("<f8").tobytes() + _packed(np.where(known, multiples, _UNKNOWN))


def frames_of(content: bytes, count: int) -> Take:
    """The frames that `frames_content` was given; ValueError where the content is something else."""
    times = np.frombuffer(content[: 8 * count], "<f8")
    multiples = _unpacked(content[8 * count :], count)
    table = multiples * _steps(multiples.shape[1] - _FIXED)
    table[multiples == _UNKNOWN] = np.nan
    arrays: dict[str, Any] = {}
    column = 0
    for name, shape, _ in LAYOUT:
        width = multiples.shape[1] - column if shape == (-1,) else int(np.prod(shape))
        arrays[name] = table[:, column : column + width].reshape(count, *(shape if width else (0,)))
        column += width
    dtypes = {"found": np.bool_, "pose": np.float64}
    arrays = {name: array.astype(dtypes.get(name, np.float32)) for name, array in arrays.items()}
    return Take(times=times.astype(np.float64), **arrays)


def _steps(modes: int) -> FloatArray:
    """(columns,) the step of each column where the model has `modes` modes."""
    widths = [modes if shape == (-1,) else int(np.prod(shape)) for _, shape, _ in LAYOUT]
    return np.concatenate([np.broadcast_to(step, width) for (_, _, step), width in zip(LAYOUT, widths, strict=True)])


def _packed(multiples: NDArray[np.int64]) -> bytes:
    """(N, D) whole numbers of 32 bits, deflated as docs/takes.md states it."""
    change = np.diff(multiples, axis=0, prepend=0).astype(np.int32)  # what does not fit wraps, and wraps back
    folded = (change << 1) ^ (change >> 31)
    planes = np.ascontiguousarray(folded.T).astype("<i4").view(np.uint8).reshape(-1, 4).T
    return zlib.compress(planes.tobytes(), 6)


def _unpacked(deflated: bytes, count: int) -> NDArray[np.int32]:
    limit = 4 * count * (_FIXED + MAX_MODES)
    stream = zlib.decompressobj()
    try:
        raw = stream.decompress(deflated, limit + 1)
    except zlib.error as error:
        raise ValueError(f"its frames cannot be unpacked: {error}") from error
    columns, rest = divmod(len(raw), 4 * count) if count else (0, 1)
    if rest or not _FIXED <= columns <= _FIXED + MAX_MODES or not stream.eof:
        raise ValueError(f"{len(raw)} bytes are no {count} frames")
    folded = np.frombuffer(raw, np.uint8).reshape(4, -1).T.copy().view("<u4").reshape(columns, count)
    change = (folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)
    return np.ascontiguousarray(np.cumsum(change, axis=1, dtype=np.int32).T)  # it wraps, as what it undoes did
