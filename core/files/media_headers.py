"""What the headers of media files state: the size of an image, read before anything is decoded, when images and sound
start, and whether images are mirrored.

A PNG of 65 bytes may state any size, and OpenCV allocates up to a thousand megapixels before it reads further.

Recordings often start with sound, such as those of browsers and screen recorders, and files that were cut without
being encoded again. Players that show images and sound separately have to shift one of them.

Front cameras and programs that flip a video without encoding it again store it mirrored. OpenCV and Blender only rotate
it, by the angle of its first axis: one that is mirrored from left to right is upside down.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, TypeVar

_T = TypeVar("_T")
VIDEO, SOUND = "video", "sound"


Size = tuple[int, int]

_PNM = re.compile(rb"P[1-6](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_JPEG_FRAMES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
_JPEG_ALONE = frozenset({0x01, 0xFF, *range(0xD0, 0xD9)})
"""Markers without a length."""
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""Starts of a TIFF file: both orders of bytes, up to 4 GB and beyond."""
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
    (TIFF, _tiff),
    (b"RIFF", _webp),
    (tuple(b"P%d" % kind for kind in range(1, 7)), _pnm),
)


Starts = Mapping[str, float]
"""Start of the first stream of each kind, in seconds of the file."""
_LARGEST_HEADER = 1 << 26
"""Largest part of a file that is read at once: the index of a film of several hours has a few megabytes."""
_MOST_ITEMS = 100_000
"""Most boxes or elements that are read: sound and images start within the first seconds of a file."""

_ALL_ITEMS = 10_000_000
"""Most elements of a whole film: three blocks of sound to an image, at 60 images per second, for ten hours."""
_FAULTS = (OSError, struct.error, IndexError, KeyError, ZeroDivisionError, OverflowError)
"""What reading a damaged file raises."""
_MATROSKA = b"\x1a\x45\xdf\xa3"
_MP4 = (b"ftyp", b"moov", b"mdat", b"wide", b"free")
"""Boxes with which an MP4 or MOV begins."""
_BOXES = {b"moov", b"trak", b"edts", b"mdia", b"minf", b"stbl"}
"""Boxes of MP4 that contain others; ISO/IEC 14496-12."""
_HANDLERS = {b"vide": VIDEO, b"soun": SOUND}

_SEGMENT, _INFO, _TRACKS, _TRACK, _CLUSTER, _GROUP = 0x18538067, 0x1549A966, 0x1654AE6B, 0xAE, 0x1F43B675, 0xA0
_PICTURE, _PROJECTION = 0xE0, 0x7670
"""Elements of Matroska that contain others; RFC 9559."""
_SCALE, _TRACK_NUMBER, _TRACK_TYPE, _TIMESTAMP, _YAW = 0x2AD7B1, 0xD7, 0x83, 0xE7, 0x7673
_BLOCKS = (0xA3, 0xA1)
_TYPES = {1: VIDEO, 2: SOUND}
_BEHIND = 180.0
"""Degrees of yaw of a flat picture that is seen from behind."""


def sound_lead(path: Path) -> float:
    """Return by how many seconds the sound of a file starts before its first image; negative if it starts later.

    It is 0 if the file has only one of them, or is of another kind than MP4, MOV, Matroska or WebM.
    """
    starts = read_starts(path)
    return starts[VIDEO] - starts[SOUND] if len(starts) == 2 else 0.0


def read_starts(path: Path) -> Starts:
    """Return the starts of the streams of a file, as far as they are known."""
    return _parsed(path, _starts_of_matroska, _starts_of_mp4, {})


def last_image(path: Path) -> float | None:
    """Return the seconds from the first image of a file to the last, whatever its sound lasts.

    It is None if the file was cut, or is of another kind than Matroska or WebM; those of other kinds that matter state
    how many images they have.
    """
    try:
        with path.open("rb") as file:
            if file.read(4) != _MATROSKA:
                return None
            times = [time for kind, time in _blocks(file, file.seek(0, 2), _ALL_ITEMS) if kind == VIDEO]
    except _FAULTS:
        return None
    return max(times) - times[0] if times else None


def lacks_index(path: Path) -> bool:
    """Return whether an MP4 or MOV has no complete index, without which it cannot be read: if it is written last, it is
    missing in files whose recording or copy was interrupted.
    """
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            place, first = 0, True
            while place + 8 <= size:
                file.seek(place)
                length, name = struct.unpack(">I4s", file.read(8))
                if first and name not in _MP4:
                    return False
                if length == 1:
                    (length,) = struct.unpack(">Q", file.read(8))
                length = length or size - place
                if name in (b"moov", b"meta"):  # of a video, or of a picture
                    return bool(place + length > size)
                place, first = place + max(length, 8), False
    except _FAULTS:
        return False
    return not first


def is_mirrored(path: Path) -> bool:
    """Return whether the images of an MP4, MOV or Matroska file are to be displayed mirrored; False if it is damaged.

    Players mirror the stored images from top to bottom, and then rotate them by the angle that OpenCV states.
    """
    return _parsed(path, _is_matroska_mirrored, _is_mp4_mirrored, False)


def _parsed(
    path: Path, of_matroska: Callable[[BinaryIO, int], _T], of_mp4: Callable[[BinaryIO, int], _T], otherwise: _T
) -> _T:
    """Return what a parser finds in a file, given its size; `otherwise` for a damaged one or another kind."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
            size = file.seek(0, 2)
            if head[:4] == _MATROSKA:
                return of_matroska(file, size)
            return of_mp4(file, size) if head[4:] in _MP4 else otherwise
    except _FAULTS:
        return otherwise


def _is_mp4_mirrored(file: BinaryIO, size: int) -> bool:
    """Both the movie and its track have a matrix; a mirroring one has a negative determinant."""
    movie = track = False
    for name, content in _boxes(file, 0, size):
        if name == b"mvhd":
            movie = _is_reflection(content, 48 if content[:1] == b"\x01" else 36)
        elif name == b"tkhd":
            track = _is_reflection(content, 52 if content[:1] == b"\x01" else 40)
        elif name == b"hdlr" and content[8:12] == b"vide":
            return movie != track
    return False


def _is_reflection(header: bytes, place: int) -> bool:
    a, b, _, c, d = struct.unpack_from(">5i", header, place)
    return int(a * d - b * c) < 0


def _is_matroska_mirrored(file: BinaryIO, size: int) -> bool:
    """A flat picture that is seen from behind is mirrored."""
    kind = 0
    for name, content in _elements(file, size, _MOST_ITEMS):
        if name in _BLOCKS:
            break
        if name == _TRACK_TYPE:
            kind = int.from_bytes(content, "big")
        elif name == _YAW and _TYPES.get(kind) == VIDEO and len(content) in (4, 8):
            (yaw,) = struct.unpack(">f" if len(content) == 4 else ">d", content)
            return bool(abs(yaw) == _BEHIND)
    return False


def _starts_of_mp4(file: BinaryIO, size: int) -> Starts:
    """An edit list delays a track by an empty edit, in the unit of the movie; otherwise its first image may be late."""
    unit = 1
    starts: dict[str, float] = {}
    track: dict[bytes, bytes] = {}

    def finish() -> None:
        kind = _HANDLERS.get(track.get(b"hdlr", b"")[8:12])
        if kind is not None:
            starts.setdefault(kind, _start_of_track(track, unit))
        track.clear()

    for name, content in _boxes(file, 0, size):
        if name == b"mvhd":
            unit = _unit_of(content)
        elif name == b"trak":
            finish()
        else:
            track.setdefault(name, content)  # MOV has a second handler, of the data
    finish()
    return starts


def _start_of_track(track: Mapping[bytes, bytes], unit: int) -> float:
    edits = track.get(b"elst", b"")
    wide = edits[:1] == b"\x01"
    row = struct.Struct(">Qqhh" if wide else ">Iihh")
    delay = 0
    for place in range(8, len(edits) - row.size + 1, row.size):
        duration, media_time, *_ = row.unpack_from(edits, place)
        if media_time != -1:
            return delay / unit
        delay += duration
    offsets = track.get(b"ctts", b"")
    shown_late = struct.unpack_from(">i", offsets, 12)[0] if len(offsets) >= 16 else 0
    return delay / unit + shown_late / _unit_of(track[b"mdhd"])


def _unit_of(header: bytes) -> int:
    """Return the ticks per second in a header of a movie or of its media."""
    return int(struct.unpack_from(">I", header, 20 if header[:1] == b"\x01" else 12)[0])


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, bytes]]:
    """Yield names and contents of the boxes that matter; that of a track is empty, and its own follow."""
    wanted = (b"mvhd", b"tkhd", b"mdhd", b"hdlr", b"elst", b"ctts")
    ends, place = [end], start
    for _ in range(_MOST_ITEMS):
        while len(ends) > 1 and place >= ends[-1]:
            ends.pop()
        if place + 8 > ends[-1]:
            return
        file.seek(place)
        length, name = struct.unpack(">I4s", file.read(8))
        header = 8
        if length == 1:
            (length,), header = struct.unpack(">Q", file.read(8)), 16
        length = length or end - place
        if length < header:
            raise struct.error("a box is shorter than its header")
        if name in _BOXES:
            if name == b"trak":
                yield name, b""
            ends.append(min(place + length, ends[-1]))
            place += header
            continue
        if name in wanted:
            yield name, file.read(min(length - header, _LARGEST_HEADER))
        place += length


def _starts_of_matroska(file: BinaryIO, size: int) -> Starts:
    starts: dict[str, float] = {}
    for kind, time in _blocks(file, size, _MOST_ITEMS):
        starts.setdefault(kind, time)
        if len(starts) == len(_TYPES):
            break
    return starts


def _blocks(file: BinaryIO, size: int, most: int) -> Iterator[tuple[str, float]]:
    """Yield kind and time in seconds of the blocks of the first track of each kind of Matroska."""
    scale, number, cluster = 1_000_000, 0, 0
    kinds: dict[int, str] = {}
    for name, content in _elements(file, size, most):
        if name == _SCALE:
            scale = int.from_bytes(content, "big")
        elif name == _TRACK_NUMBER:
            number = int.from_bytes(content, "big")
        elif name == _TRACK_TYPE:
            kind = _TYPES.get(int.from_bytes(content, "big"))
            if kind is not None and kind not in kinds.values():
                kinds[number] = kind
        elif name == _TIMESTAMP:
            cluster = int.from_bytes(content, "big")
        elif name in _BLOCKS:
            track, place = _number(content, 0, keep_length=False)
            (relative,) = struct.unpack_from(">h", content, place)
            if track in kinds:
                yield kinds[track], (cluster + relative) * scale * 1e-9


def _elements(file: BinaryIO, size: int, most: int) -> Iterator[tuple[int, bytes]]:
    """Yield ids and contents of the elements that matter, of blocks only the beginning.

    Raises struct.error at the end of a file that ends before an element does; a recording of a browser states no ends.
    """
    inside = (_SEGMENT, _INFO, _TRACKS, _TRACK, _PICTURE, _PROJECTION, _CLUSTER, _GROUP)
    wanted = (_SCALE, _TRACK_NUMBER, _TRACK_TYPE, _TIMESTAMP, _YAW, *_BLOCKS)
    place = end = 0
    for _ in range(most):
        file.seek(place)
        head = file.read(12)
        if len(head) < 2:
            break
        name, first = _number(head, 0, keep_length=True)
        length, second = _number(head, first, keep_length=False)
        place += second
        if name not in inside or length < (1 << 7 * (second - first)) - 1:
            end = max(end, place + length)
        if name in inside:
            continue
        if name in wanted:
            file.seek(place)
            yield name, file.read(min(length, 16))
        place += length
    if end > size:
        raise struct.error("an element ends after the file")


def _number(data: bytes, place: int, *, keep_length: bool) -> tuple[int, int]:
    """Return a number of variable length, with or without the bit that states its length, and the place after it."""
    length = 9 - data[place].bit_length()
    if length > 8:
        raise struct.error("a number is too long")
    value = int.from_bytes(data[place : place + length], "big")
    return value if keep_length else value & ((1 << (7 * length)) - 1), place + length
