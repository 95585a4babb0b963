"""Reading of video files, with the presentation time of each frame, and of image files, which are also written.

Times are those in the container, not frame numbers over the nominal rate: phones and webcams record at a variable
rate, and animation that is timed by counting frames would drift from their sound.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import Message, OutputError, SourceError
from ..numeric.opencv import silence_opencv
from .changing_format import Stream, stamp_of
from .closing import Closing
from .frame_rate import FASTEST, nominal_rate
from .frames import Frame
from .media_headers import TIFF, is_mirrored, lacks_index, stated_size
from .orientation import oriented, webp_orientation
from .picture_names import in_order, places
from .reading import read_bytes
from .writing import reason_of, replacing

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

MAX_PIXELS = 1 << 26
"""Largest number of pixels of a frame, 8192 by 8192: decoding a larger one takes gigabytes."""
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+:|subfile,", re.IGNORECASE)
_MOST_STRETCHED = 4.0
"""Largest ratio of the sides of a pixel; any other is taken for a mistake in the file."""
_SQUARE = 0.02
"""Difference of this ratio from 1 up to which pixels are square: rounded sizes of a file are off by less."""
_LOOKED_AT = 60
"""Number of frames whose times give the rate if the file states one at which no camera records."""


_BACK = 1.0
"""Seconds by which times go back where a file was joined from several, so that its clock starts again: images that are
out of order are less than that apart."""
_LEAST = 1e-3
"""Smallest step in seconds, as files of most recorders have, between frames that would be out of order."""


class VideoSource(Closing):
    """A video file: a context manager, and an iterator over its frames in order.

    Parameters
    ----------
    path : Path
        Any file that OpenCV's FFmpeg reads: H.264, HEVC, MPEG-4, VP8/9, MJPEG; not AV1. Frames are rotated upright and
        mirrored as the file states, as phone videos require, and stretched if their pixels are not square, as those of
        DV are.

    Attributes
    ----------
    turn : int
        Degrees by which the stored frames are rotated clockwise: 0, 90, 180 or 270.
    mirrored : bool
        Whether they are mirrored from top to bottom before.
    pixel_aspect : float
        Width of the stored pixels, before they are rotated and stretched, divided by their height.
    fps : float
        Nominal rate in frames per second, or the usual one of the times if the file states none, an impossible one, or
        the mean of a recording that skips frames, as phones' do.
    frame_count : int
        Stated number of frames, which may be wrong; 0 if unknown.

    Raises
    ------
    SourceError
        If there is no such file, it is not a video, its frames are too large, or none of them can be decoded.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        require_file(self.path)
        require_utf8_name(self.path)
        silence_opencv()
        # FFmpeg takes text before a colon for a protocol, unless the path begins with a slash.
        self._capture = cv2.VideoCapture(os.path.abspath(self.path), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            if lacks_index(self.path):
                raise SourceError(
                    "{path} is incomplete: its index, which is written last, is missing. "
                    "Copy or record it again, or repair it.",
                    path=self.path,
                )
            raise SourceError(
                "{path} cannot be read as a video. Convert it to MP4 (H.264) and try again.", path=self.path
            )
        width, height = (int(self._capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_PIXELS:
            self._capture.release()
            raise SourceError(
                "The frames of {path} are too large: {width} x {height} pixels. Scale it down.",
                path=self.path,
                width=width,
                height=height,
            )
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        self.turn = round(self._capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360
        self.mirrored = is_mirrored(self.path)
        self.pixel_aspect = self._pixel_aspect()
        self._stated = (width, height) if self.turn % 180 == 0 else (height, width)
        self._stream = Stream(self.path, self._capture)
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = nominal_rate(fps, self._first_times)
        count = float(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        # A file that states no number of frames only states how long it lasts.
        count *= self.fps / fps if fps > FASTEST else 1.0
        self.frame_count = max(0, int(count)) if np.isfinite(count) else 0

    def __iter__(self) -> Iterator[Frame]:
        for index, time in enumerate(self.times()):
            if (image := self.image()) is None:
                if index == 0:
                    raise self._undecodable()
                break
            yield Frame(image, time, index)

    def image(self) -> NDArray[np.uint8] | None:
        """Return the image of the frame at which `times` is, (H, W, 3) BGR, or None if it cannot be decoded."""
        if (image := self._stream.image(self.turn)) is None:
            return None
        if self.mirrored:  # it is rotated
            image = np.asarray(cv2.flip(image, 0 if self.turn % 180 == 0 else 1), dtype=np.uint8)
        return self._stream.fitted(self._squared(image), self._square(*self._stated))

    def times(self) -> Iterator[float]:
        """Advance from frame to frame, and yield the time of each in seconds from the first one."""
        start, last, previous = 0.0, None, None
        for stamp in self._stream.stamps():
            time = 0.0 if previous is None else previous + 1.0 / self.fps
            if stamp is not None:
                if last is None or stamp < last - _BACK:
                    start = stamp - time
                elif stamp > last:  # otherwise only this frame has no time of its own
                    time = stamp - start
                last = stamp
            previous = time if previous is None else max(time, previous + _LEAST)
            yield previous
        if previous is None:
            raise self._undecodable()

    def _undecodable(self) -> SourceError:
        return SourceError(
            "No frame of {path} can be decoded: it is empty, broken, or in an unsupported codec such as AV1. "
            "Convert it to MP4 (H.264) and try again.",
            path=self.path,
        )

    def _pixel_aspect(self) -> float:
        sides = [float(self._capture.get(side)) for side in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN)]
        aspect = sides[0] / sides[1] if min(sides) > 0.0 else 1.0
        believed = 1.0 / _MOST_STRETCHED <= aspect <= _MOST_STRETCHED and abs(aspect - 1.0) > _SQUARE
        return aspect if believed else 1.0

    def _squared(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return an upright image with square pixels; the side that is too short grows."""
        size = self._square(*image.shape[1::-1])
        if size == image.shape[1::-1]:
            return image
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)

    def _square(self, width: int, height: int) -> tuple[int, int]:
        """Return the width and the height of an upright image in square pixels."""
        wider = self.pixel_aspect if self.turn % 180 == 0 else 1.0 / self.pixel_aspect
        return round(width * max(wider, 1.0)), round(height * max(1.0 / wider, 1.0))

    def _first_times(self) -> list[float]:
        frames = cv2.VideoCapture(os.path.abspath(self.path), cv2.CAP_FFMPEG)
        stamps = [stamp_of(frames) for _ in range(_LOOKED_AT) if frames.grab()]
        frames.release()
        return [stamp for stamp in stamps if stamp is not None]

    def close(self) -> None:
        """Release the file; may be called twice."""
        self._stream.close()


PICTURE_RATE = 25.0
"""Frames per second of pictures, unless another rate is given."""


class PictureSource(Closing):
    """The pictures in a folder as the frames of a video, in the order of their names; 2.png comes before 10.png.

    Pictures that cannot be read are skipped, and so are missing ones of a numbered sequence: later ones keep their
    times. `fps` is the rate, `frame_count` the number of pictures, and `skipped` the number of pictures that were not
    shown so far. Raises SourceError if the rate is impossible, or the folder is missing or has no pictures; while
    reading, if no picture can be read.
    """

    def __init__(self, folder: Path, rate: float = PICTURE_RATE) -> None:
        if not 0.1 <= rate <= 1000.0:
            raise SourceError(
                "The rate must be between 0.1 and 1000 frames per second; got {rate:g}. Use 25, for instance.",
                rate=rate,
            )
        self.path, self.fps = Path(folder), rate
        self._pictures = pictures_in(self.path)
        if not self._pictures:
            raise SourceError("There are no images in {folder}. Use JPEG, PNG, BMP, TIFF or WebP.", folder=folder)
        self.frame_count = len(self._pictures)
        self.skipped = 0

    def __iter__(self) -> Iterator[Frame]:
        unreadable: SourceError | None = None
        shown, start = 0, None
        for place, picture in zip(places(self._pictures), self._pictures, strict=True):
            try:
                image = read_image(picture)
            except SourceError as error:
                unreadable = error
                continue
            if place is not None:
                start = place if start is None else start
                self.skipped = place - start - shown
            yield Frame(image, (shown + self.skipped) / self.fps, shown)
            shown += 1
        if not shown and unreadable is not None:
            raise unreadable

    def close(self) -> None:
        """Do nothing, as no file is open."""


def pictures_in(folder: Path) -> list[Path]:
    """Return the pictures in a folder by name, numbers in their order; SourceError if it cannot be read."""
    if not os.path.isdir(folder):
        raise SourceError("There is no folder {folder}. Choose the folder with the images.", folder=folder)
    try:
        pictures = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    except OSError as error:
        raise unreadable_folder(folder, error) from error
    return in_order(pictures)


def unreadable_folder(folder: Path, error: OSError) -> SourceError:
    """Return the error for a folder whose files cannot be listed."""
    return SourceError(
        "The folder {folder} cannot be read: {error}. Change its permissions.", folder=folder, error=reason_of(error)
    )


def open_video(path: Path, rate: float = PICTURE_RATE) -> VideoSource | PictureSource:
    """Open a video, or a folder of pictures, which are shown at a rate in frames per second."""
    return PictureSource(path, rate) if os.path.isdir(path) else VideoSource(path)


def require_file(path: Path) -> None:
    """Raise a SourceError if `path` is missing, not a regular file, or not readable."""
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check the path.", path=path)


def check_readable(path: Path) -> bool:
    """Return whether there is a file at `path`.

    Raises SourceError if it is something else, such as a folder or a pipe, which may never end, or if it is not
    readable.
    """
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return False
    except PermissionError as error:
        raise SourceError(
            "{path} cannot be read: no permission to enter its folder. Change the folder's permissions.", path=path
        ) from error
    except (OSError, ValueError) as error:  # too long, a loop of links, a zero byte
        reason = reason_of(error) if isinstance(error, OSError) else error
        raise SourceError("{path} cannot be read: {reason}. Check the path.", path=path, reason=reason) from error
    if not stat.S_ISREG(mode):
        kind = "" if stat.S_ISDIR(mode) else Message(" but a pipe or a device")
        raise SourceError("{path} is not a file{kind}. Choose a file.", path=path, kind=kind)
    if not os.access(path, os.R_OK):
        raise SourceError(
            "{path} cannot be read: no permission. Change its permissions or copy it elsewhere.", path=path
        )
    return True


def require_utf8_name(path: Path) -> None:
    """Raise a SourceError if the absolute path is not valid UTF-8, which would crash OpenCV and Blender."""
    whole = os.path.abspath(path)
    try:
        whole.encode()
    except UnicodeEncodeError as error:
        name = os.fsencode(whole).decode(errors="backslashreplace")
        raise SourceError("The name of {name} is not valid UTF-8. Rename it and try again.", name=name) from error


def is_address(text: str) -> bool:
    """Return whether FFmpeg would take `text` for an address, such as `http:host/x`, and might access the network.

    A Windows drive letter is not an address.
    """
    return _ADDRESS.match(text) is not None


IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})


MAX_IMAGE_PIXELS = 100_000_000
"""Largest number of pixels: an image of 16,384 pixels per side takes two gigabytes and 15 seconds."""
MAX_SIDE = 30_000
"""Largest number of pixels per side; OpenCV cannot warp more than 32,767."""
_MAX_FILE = 1 << 30


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8 BGR, rotated upright according to EXIF.

    Raises SourceError if there is no such file, or it is not an image, or exceeds `MAX_PIXELS` or `MAX_SIDE`.
    """
    path = Path(path)
    require_file(path)
    silence_opencv()
    try:
        data = read_bytes(path, _MAX_FILE)
        size = stated_size(data)
        if size is not None and (max(size) > MAX_SIDE or size[0] * size[1] > MAX_IMAGE_PIXELS):
            raise SourceError(
                "{path} is {width} x {height} pixels; the limit is {max_pixels} megapixels "
                "and {max_side} pixels per side. Scale it down and try again.",
                path=path,
                width=size[0],
                height=size[1],
                max_pixels=MAX_IMAGE_PIXELS // 10**6,
                max_side=MAX_SIDE,
            )
        image = None if size is None else _decoded(data)
    except (OSError, ValueError, cv2.error) as error:
        raise _unreadable(path) from error
    if image is None:
        raise _unreadable(path)
    return image


def _decoded(data: bytes) -> NDArray[np.uint8] | None:
    """Decode an image, (H, W, 3) BGR; None if that is impossible."""
    stored = np.frombuffer(data, np.uint8)
    if data[8:12] == b"WEBP":
        stored_image = cv2.imdecode(stored, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if stored_image is None:
            return None
        return oriented(np.asarray(stored_image, dtype=np.uint8), webp_orientation(data))
    image = cv2.imdecode(stored, cv2.IMREAD_UNCHANGED) if data.startswith(TIFF) else None
    if image is None or image.dtype.kind != "f":
        image = cv2.imdecode(stored, cv2.IMREAD_COLOR)
        return None if image is None else np.asarray(image, dtype=np.uint8)
    # OpenCV does not convert floating-point numbers, or only as light. Blender shows them as they are, 1 as white.
    channels = np.atleast_3d(image)
    colours = channels[..., :3] if channels.shape[2] >= 3 else np.repeat(channels[..., :1], 3, axis=2)
    return np.asarray(np.rint(255.0 * np.clip(np.nan_to_num(colours), 0.0, 1.0)), dtype=np.uint8)


def _unreadable(path: Path) -> SourceError:
    return SourceError("{path} cannot be read as an image. Convert it to JPEG or PNG and try again.", path=path)


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an image (H, W, 3), BGR, in the format given by the suffix.

    Raises OutputError if the suffix is unknown, the image is too large for the format, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        raise OutputError("Cannot write {path}: use the suffix .png or .jpg.", path=path)
    try:
        done, data = cv2.imencode(path.suffix, image)
    except cv2.error:  # some formats raise where others return False
        done = False
    if not done:
        height, width = image.shape[:2]
        raise OutputError(
            "Cannot write {path}: a {suffix} file cannot hold {width} x {height} pixels. Use the suffix .png.",
            path=path,
            suffix=path.suffix,
            width=width,
            height=height,
        )
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
