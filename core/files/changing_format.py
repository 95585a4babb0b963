"""Videos whose images change their size, or how their colours are stored, midway.

Calls that adapt to the network are recorded so, and so are phones that are turned. OpenCV's reader converts all images
as the first one is stored: the others are garbled, or it reads beyond its memory. Yet it also delivers the encoded
packets, whose headers tell where another format begins. From there on they are copied to a file of their own, for
another reader.
"""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric.opencv import silence_opencv
from .closing import Closing

_AHEAD = 64
"""Packets that are read ahead of the images: decoders hold back at most 16 images, of two packets each."""
_BACK = 1.0
"""Seconds by which a clock goes back where it starts again, as in `VideoSource`."""
_LATEST = 1e9
"""Seconds at which no image is shown: 32 years; clocks in files start at most at some days."""
_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
"""OpenCV's codes of rotations by degrees."""
_START = b"\0\0\1"
"""What begins each unit of a stream of MPEG."""


def stamp_of(capture: cv2.VideoCapture) -> float | None:
    """Return when the image or packet is shown in seconds of the file; None if the file does not say, as streams
    without a container do not, for which OpenCV returns an impossible number.
    """
    stamp = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
    return stamp if abs(stamp) < _LATEST else None


class Packet(NamedTuple):
    """An encoded image; `time` in seconds of the file, None if it has none. `is_shown` is False for mere references."""

    data: bytes
    time: float | None
    is_key: bool
    is_shown: bool


def _mjpeg(data: bytes) -> bytes:
    """Size and sampling of a JPEG image."""
    at = 2
    while at + 9 < len(data) and data[at] == 0xFF:
        if 0xC0 <= data[at + 1] <= 0xC3:
            parts = data[at + 9]
            return data[at + 4 : at + 10] + b"".join(data[at + 11 + 3 * n : at + 12 + 3 * n] for n in range(parts))
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return b""


def _units(data: bytes) -> Iterator[bytes]:
    """Yield the units of a stream of MPEG, without the codes before them."""
    at = data.find(_START)
    while at >= 0:
        following = data.find(_START, at + 3)
        yield data[at + 3 : following if following >= 0 else len(data)]
        at = following


def _h264(data: bytes) -> bytes:
    """Sequence parameter sets; ITU-T H.264, 7.3.1."""
    return _before(data, lambda unit: unit[0] & 31 == 7, lambda unit: unit[0] & 31 in (1, 2, 5))


def _hevc(data: bytes) -> bytes:
    """Sequence parameter sets; ITU-T H.265, 7.3.1."""
    return _before(data, lambda unit: unit[0] >> 1 & 63 == 33, lambda unit: unit[0] >> 1 & 63 < 32)


def _mpeg4(data: bytes) -> bytes:
    """Headers of video object layers; ISO/IEC 14496-2, 6.2.3."""
    return _before(data, lambda unit: 0x20 <= unit[0] <= 0x2F, lambda unit: unit[0] == 0xB6)


def _mpeg2(data: bytes) -> bytes:
    """Size and shape of pixels in sequence headers; ISO/IEC 13818-2, 6.2.2.1."""
    return _before(data, lambda unit: unit[0] == 0xB3, lambda unit: unit[0] == 0)[:5]


def _before(data: bytes, chosen: Callable[[bytes], bool], ends: Callable[[bytes], bool]) -> bytes:
    """Return the units that are chosen before the first one of an image."""
    found = b""
    for unit in _units(data):
        if unit and ends(unit):
            break
        if unit and chosen(unit):
            found += unit.rstrip(b"\0")
    return found


def _vp8(data: bytes) -> bytes:
    """Size of a key frame; RFC 6386, 9.1."""
    return data[6:10] if data[3:6] == b"\x9d\x01\x2a" and len(data) >= 10 else b""


def _vp9(data: bytes) -> bytes:
    """Colours and size of a key frame; the VP9 bitstream specification, 6.2."""
    if data[1:4] != b"\x49\x83\x42" or len(data) < 9:
        return b""
    bits = {0: 36, 1: 37, 2: 39}[data[0] >> 4 & 3]
    return bytes([data[0] & 0xF0, *data[4:8]]) + bytes([data[8] & 0xFF << (40 - bits) & 0xFF])


class _Codec(NamedTuple):
    suffix: str
    format: Callable[[bytes], bytes]
    ivf: bytes = b""


_CODECS = {
    "mjpg": _Codec(".mjpeg", _mjpeg),
    "jpeg": _Codec(".mjpeg", _mjpeg),
    **dict.fromkeys(("h264", "avc1", "avc3", "x264"), _Codec(".h264", _h264)),
    **dict.fromkeys(("hevc", "hvc1", "hev1", "h265"), _Codec(".hevc", _hevc)),
    **dict.fromkeys(("fmp4", "mp4v", "xvid", "divx", "dx50"), _Codec(".m4v", _mpeg4)),
    **dict.fromkeys(("mpg1", "mpg2", "mpeg"), _Codec(".m2v", _mpeg2)),
    **dict.fromkeys(("vp80", "vp08"), _Codec(".ivf", _vp8, b"VP80")),
    **dict.fromkeys(("vp90", "vp09"), _Codec(".ivf", _vp9, b"VP90")),
}
"""By OpenCV's code of four letters."""


class Part(Closing):
    """The images of a video from a change of their format to the next: a decoder, and their times in its file."""

    def __init__(self, folder: Path, path: Path, times: list[float | None]) -> None:
        self._folder, self._times = folder, times
        self.capture = cv2.VideoCapture(os.path.abspath(path), cv2.CAP_FFMPEG)

    def stamps(self) -> Iterator[float | None]:
        """Advance from image to image, and yield the time of each."""
        number = 0
        while self.capture.grab():
            yield self._times[number] if number < len(self._times) else None
            number += 1

    def close(self) -> None:
        """Release and remove the file; may be called twice."""
        self.capture.release()
        shutil.rmtree(self._folder, ignore_errors=True)


class Parts(Closing):
    """The parts of a video that follow its first change of format; none if its codec is not one of `_CODECS`."""

    def __init__(self, path: Path, fourcc: int) -> None:
        self._codec = _CODECS.get(int(fourcc).to_bytes(4, "little", signed=fourcc < 0).decode("latin-1").lower())
        self._format, self._count = b"", 0
        self._latest: float | None = None
        self._last: float | None = None
        self._next: Packet | None = None
        self._part: Part | None = None
        self._raw: cv2.VideoCapture | None = None
        if self._codec is not None:
            silence_opencv()
            self._raw = cv2.VideoCapture(os.path.abspath(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])

    def begins(self, number: int, stamp: float | None) -> bool:
        """Return whether the image of a number, from 0, at a time of the file belongs to the first of the parts."""
        while self._next is None and self._count < number + _AHEAD and self._read() is not None:
            pass
        last, self._last = self._last, stamp
        if self._next is None:
            return False
        time, latest = self._next.time, self._latest
        if number >= self._count:
            return True
        if time is None or latest is None or stamp is None:
            return False
        if time > latest:
            return stamp >= time
        return last is not None and abs(stamp - time) < abs(stamp - last)  # the clock starts again there

    def following(self) -> Part | None:
        """Close the present part, and return the next one; None after the last."""
        self._close_part()
        while self._next is None and self._read() is not None:
            pass
        if self._next is None or self._codec is None:
            return None
        folder = Path(tempfile.mkdtemp(prefix="facemime-"))
        path, times = folder / f"part{self._codec.suffix}", _Times()
        try:
            with path.open("wb") as file:
                packet: Packet | None = self._next
                self._format, self._next = self._codec.format(self._next.data), None
                file.write(self._header())
                while packet is not None:
                    file.write(struct.pack("<IQ", len(packet.data), 0) if self._codec.ivf else b"")
                    file.write(packet.data)
                    if packet.is_shown:
                        times.add(packet.time)
                    packet = self._read()
        except OSError:  # without room for a copy, the video ends here
            shutil.rmtree(folder, ignore_errors=True)
            return None
        self._part = Part(folder, path, times.in_order())
        return self._part

    def _header(self) -> bytes:
        """Return the header of the file of a part, which raw streams have none of."""
        assert self._codec is not None
        if not self._codec.ivf:
            return b""
        sides = struct.unpack("<HH", self._format) if len(self._format) == 4 else (1, 1)
        width, height = (side & 0x3FFF for side in sides)
        return struct.pack("<4sHH4sHHIIII", b"DKIF", 0, 32, self._codec.ivf, width, height, 25, 1, 0, 0)

    def _read(self) -> Packet | None:
        """Return the next packet of the same format; None at the end, or if `_next` has another format."""
        if self._raw is None or self._codec is None or self._next is not None:
            return None
        read, data = self._raw.read()
        if not read or data is None:
            self._raw.release()
            self._raw = None
            return None
        packet = self._packet(np.asarray(data, dtype=np.uint8))
        form = self._codec.format(packet.data) if packet.is_key else b""
        if form and self._format and form != self._format:
            self._next = packet
            return None
        self._format = form or self._format
        self._count += packet.is_shown
        if packet.time is not None:
            self._latest = packet.time if self._latest is None else max(self._latest, packet.time)
        return packet

    def _packet(self, data: NDArray[np.uint8]) -> Packet:
        assert self._raw is not None and self._codec is not None
        whole = data.tobytes()
        shown = self._codec.ivf != b"VP80" or bool(whole[0] & 0x10)
        key = bool(self._raw.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME))
        return Packet(whole, stamp_of(self._raw), key, shown)

    def _close_part(self) -> None:
        if self._part is not None:
            self._part.close()
            self._part = None

    def close(self) -> None:
        """Release the files, and remove that of the last part; may be called twice."""
        self._close_part()
        if self._raw is not None:
            self._raw.release()
            self._raw = None


class Stream(Closing):
    """All images of a video, whose `capture` is closed with it."""

    def __init__(self, path: Path, capture: cv2.VideoCapture) -> None:
        self._path, self._capture = path, capture
        self._parts: Parts | None = None
        self._part: Part | None = None

    def stamps(self) -> Iterator[float | None]:
        """Advance from image to image, and yield the time of each in the file, as `stamp_of`."""
        number = 0
        self._parts = Parts(self._path, int(self._capture.get(cv2.CAP_PROP_FOURCC)))
        while self._capture.grab():
            stamp = stamp_of(self._capture)
            if self._parts.begins(number, stamp):
                break
            yield stamp
            number += 1
        while (part := self._parts.following()) is not None:
            self._part = part
            yield from part.stamps()

    def image(self, turn: int) -> NDArray[np.uint8] | None:
        """Return the image at which `stamps` is, (H, W, 3) BGR, rotated clockwise by the degrees that the file states;
        None if it cannot be decoded.
        """
        try:
            read, image = (self._capture if self._part is None else self._part.capture).retrieve()
        except cv2.error:  # its headers are damaged
            return None
        if not read or image is None:
            return None
        if self._part is not None and turn in _TURNS:
            image = cv2.rotate(image, _TURNS[turn])
        return np.asarray(image, dtype=np.uint8)

    def fitted(self, image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
        """Return an image (H, W, 3) of another format in a width and height, with black where its shape differs."""
        return image if self._part is None else fitted(image, size)

    def close(self) -> None:
        """Release the file; may be called twice."""
        self._capture.release()
        if self._parts is not None:
            self._parts.close()


def fitted(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) in a width and height, with black beside or above it if its shape differs."""
    if image.shape[1::-1] == size:
        return image
    scale = min(most / side for most, side in zip(size, image.shape[1::-1], strict=True))
    width, height = (min(round(scale * side), most) for side, most in zip(image.shape[1::-1], size, strict=True))
    left, top = (size[0] - width) // 2, (size[1] - height) // 2
    framed = np.zeros((size[1], size[0], 3), np.uint8)
    framed[top : top + height, left : left + width] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return framed


class _Times:
    """Times of packets, which are decoded in another order than they are shown in."""

    def __init__(self) -> None:
        self._runs: list[list[float | None]] = [[]]
        self._latest: float | None = None  # of the last run

    def add(self, time: float | None) -> None:
        """Add the time of a packet; one without a time, or at which the clock starts again, begins another run."""
        run, latest = self._runs[-1], self._latest
        if run and (time is None or latest is None or time < latest - _BACK):
            self._runs.append([time])
            self._latest = time
        else:
            run.append(time)
            self._latest = time if time is None or latest is None else max(latest, time)

    def in_order(self) -> list[float | None]:
        """Return the times in the order in which the images are shown."""
        return [time for run in self._runs for time in sorted(run, key=lambda time: -np.inf if time is None else time)]
