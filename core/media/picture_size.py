"""The size stated in the header of an image file, read before anything is decoded.

A PNG of 65 bytes may state any size, and OpenCV allocates up to a thousand megapixels before it reads further.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

Size = tuple[int, int]

_PNM = re.compile(rb"P[1-6](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_JPEG_FRAMES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
_JPEG_ALONE = frozenset({0x01, 0xFF, *range(0xD0, 0xD9)})
"""Markers without a length."""
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257


def stated_size(data: bytes) -> Size | None:
    """Width and height in pixels of a PNG, JPEG, BMP, TIFF, WebP, PGM or PPM file; None for any other `data`."""
    for start, read in _READERS:
        if data.startswith(start):
            try:
                return read(data)
            except (struct.error, IndexError):  # truncated header
                return None
    return None


def _png(data: bytes) -> Size | None:
    width, height = struct.unpack_from(">II", data, 16)
    return (width, height) if data[12:16] == b"IHDR" else None


def _jpeg(data: bytes) -> Size | None:
    at = 2
    while True:
        if data[at] != 0xFF:  # skip data between segments, as OpenCV's decoder does
            at = data.find(b"\xff", at)
            if at < 0:
                return None
        marker = data[at + 1]
        if marker in _JPEG_ALONE:
            at += 1 if marker == 0xFF else 2
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])


def _bmp(data: bytes) -> Size | None:
    (header,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", data, 18)
    return abs(width), abs(height)


def _tiff(data: bytes) -> Size | None:
    order = "<" if data.startswith(b"II") else ">"
    (kind,) = struct.unpack_from(order + "H", data, 2)
    if kind == 43:  # BigTIFF
        at = struct.unpack_from(order + "Q", data, 8)[0]
        (count,), at, step, value = struct.unpack_from(order + "Q", data, at), at + 8, 20, 12
    else:
        at = struct.unpack_from(order + "I", data, 4)[0]
        (count,), at, step, value = struct.unpack_from(order + "H", data, at), at + 2, 12, 8
    sides: dict[int, int] = {}
    for entry in range(at, min(at + count * step, len(data) - step + 1), step):
        tag, number = struct.unpack_from(order + "HH", data, entry)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            form = {1: "B", 3: "H", 4: "I", 16: "Q"}.get(number, "I")
            sides[tag] = max(sides.get(tag, 0), int(struct.unpack_from(order + form, data, entry + value)[0]))
    return (sides[_TIFF_WIDTH], sides[_TIFF_HEIGHT]) if len(sides) == 2 else None


def _webp(data: bytes) -> Size | None:
    if data[8:12] != b"WEBP":
        return None
    kind = data[12:16]
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[at : at + 3], "little") + 1 for at in (24, 27))
        return width, height
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


def _pnm(data: bytes) -> Size | None:
    found = _PNM.match(data[:4096])
    return (int(found[1]), int(found[2])) if found else None


_READERS: tuple[tuple[bytes | tuple[bytes, ...], Callable[[bytes], Size | None]], ...] = (
    (b"\x89PNG\r\n\x1a\n", _png),
    (b"\xff\xd8", _jpeg),
    (b"BM", _bmp),
    ((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), _tiff),
    (b"RIFF", _webp),
    (tuple(b"P%d" % kind for kind in range(1, 7)), _pnm),
)
