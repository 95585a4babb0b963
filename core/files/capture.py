"""Reading of video files, with the presentation time of each frame, and of image files, which are also written.

Times are those in the container, not frame numbers over the nominal rate: phones and webcams record at a variable
rate, and animation that is timed by counting frames would drift from their sound.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import Message, OutputError, SourceError
from ..numeric.opencv import silence_opencv
from .closing import Closing
from .media_headers import stated_size
from .reading import read_bytes
from .writing import reason_of, replacing

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

MAX_PIXELS = 1 << 26
"""Largest number of pixels of a frame, 8192 by 8192: decoding a larger one takes gigabytes."""
_NUMBERED = re.compile(r"(\D*)(\d*)")
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+:|subfile,", re.IGNORECASE)
_ROOM = 1 << 27
"""Bytes of the last images that are kept, so that a step back need not decode the video again."""
_BEFORE = 0.5
"""Seconds before a frame that was jumped to in which images are kept as well."""


@dataclass(frozen=True)
class Frame:
    """A frame of a video.

    Attributes
    ----------
    image : (H, W, 3) uint8
        BGR.
    time : float
        Seconds from the first frame.
    index : int
        Number of the frame in the source, from 0.
    """

    image: NDArray[np.uint8]
    time: float
    index: int


class VideoSource(Closing):
    """A video file: a context manager, and an iterator over its frames in order.

    Parameters
    ----------
    path : Path
        Any file that OpenCV's FFmpeg reads: H.264, HEVC, MPEG-4, VP8/9, MJPEG; not AV1. Frames are rotated upright as
        the file states, as phone videos require.

    Attributes
    ----------
    turn : int
        Degrees by which the stored frames are rotated clockwise: 0, 90, 180 or 270.
    fps : float
        Nominal rate in frames per second; 25 if the file states none.
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
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = fps if np.isfinite(fps) and 1.0 <= fps <= 1000.0 else 25.0
        self.frame_count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))

    def __iter__(self) -> Iterator[Frame]:
        for index, time in enumerate(self.times()):
            if (image := self.image()) is None:
                break
            yield Frame(image, time, index)

    def image(self) -> NDArray[np.uint8] | None:
        """Return the image of the frame at which `times` is, (H, W, 3) BGR, or None if it cannot be decoded."""
        read, image = self._capture.retrieve()
        return np.asarray(image, dtype=np.uint8) if read and image is not None else None

    def times(self) -> Iterator[float]:
        """Advance from frame to frame, and yield the time of each in seconds from the first one."""
        start = previous = None
        while self._capture.grab():
            stamp = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
            if previous is not None and not stamp > previous:
                stamp = previous + 1.0 / self.fps
            start = stamp if start is None else start
            previous = stamp
            yield stamp - start
        if start is None:
            raise SourceError(
                "No frame of {path} can be decoded: it is empty, broken, or in an unsupported codec such as AV1. "
                "Convert it to MP4 (H.264) and try again.",
                path=self.path,
            )

    def close(self) -> None:
        """Release the file; may be called twice."""
        self._capture.release()


PICTURE_RATE = 25.0
"""Frames per second of pictures, unless another rate is given."""


class PictureSource(Closing):
    """The pictures in a folder as the frames of a video, in the order of their names; 2.png comes before 10.png.

    Pictures that cannot be read are skipped. `fps` is the rate, and `frame_count` the number of pictures. Raises
    SourceError if the rate is impossible, or the folder is missing or has no pictures; while reading, if no picture can
    be read.
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

    def __iter__(self) -> Iterator[Frame]:
        unreadable: SourceError | None = None
        shown = 0
        for picture in self._pictures:
            try:
                image = read_image(picture)
            except SourceError as error:
                unreadable = error
                continue
            yield Frame(image, shown / self.fps, shown)
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
    return sorted(pictures, key=lambda path: [(int(n or 0), text) for text, n in _NUMBERED.findall(path.name)])


def unreadable_folder(folder: Path, error: OSError) -> SourceError:
    """Return the error for a folder whose files cannot be listed."""
    return SourceError(
        "The folder {folder} cannot be read: {error}. Change its permissions.", folder=folder, error=reason_of(error)
    )


def open_video(path: Path, rate: float = PICTURE_RATE) -> VideoSource | PictureSource:
    """Open a video, or a folder of pictures, which are shown at a rate in frames per second."""
    return PictureSource(path, rate) if os.path.isdir(path) else VideoSource(path)


def at_constant_rate(frames: Iterable[Frame], fps: float) -> Iterator[Frame]:
    """Resample frames to a constant rate, each moment showing the frame that was on display then, with its index."""
    emitted = 0
    shown: Frame | None = None
    for frame in frames:
        while shown is not None and emitted / fps < frame.time - 0.5 / fps:
            yield Frame(shown.image, emitted / fps, shown.index)
            emitted += 1
        shown = frame
    if shown is not None:
        yield Frame(shown.image, emitted / fps, shown.index)


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
        image = None if size is None else cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except (OSError, ValueError, cv2.error) as error:
        raise _unreadable(path) from error
    if image is None:
        raise _unreadable(path)
    return np.asarray(image, dtype=np.uint8)


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


class FrameFinder(Closing):
    """Finds the frame of a video at a time.

    Frames are decoded one after the other, from the first one again to go far back: few files state well where a frame
    is, so a jump would miss it. A frame on the way costs about a millisecond. Raises SourceError as `VideoSource`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kept: dict[float, NDArray[np.uint8]] = {}
        self._open()

    def _open(self) -> None:
        self._video = VideoSource(self._path)
        self._times = self._video.times()
        self._time = -np.inf

    def at(self, seconds: float) -> NDArray[np.uint8] | None:
        """Return the image of the frame nearest to a time from the first frame, (H, W, 3) BGR, or None.

        Raises SourceError if the file can no longer be read.
        """
        near = 0.5 / self._video.fps
        if (kept := self._nearest(seconds, near)) is not None:
            return kept
        if self._time > seconds - near:
            self.close()
            self._open()
        for time in self._times:
            self._time = time
            if time >= seconds - _BEFORE and (image := self._video.image()) is not None:
                self._keep(time, image)
            if time >= seconds - near:
                break
        return self._nearest(seconds, near)

    def _nearest(self, seconds: float, near: float) -> NDArray[np.uint8] | None:
        time = min(self._kept, key=lambda time: abs(time - seconds), default=np.inf)
        return self._kept[time] if abs(time - seconds) <= near else None

    def _keep(self, time: float, image: NDArray[np.uint8]) -> None:
        self._kept.pop(time, None)
        self._kept[time] = image
        while len(self._kept) > 1 and sum(kept.nbytes for kept in self._kept.values()) > _ROOM:
            del self._kept[next(iter(self._kept))]

    def close(self) -> None:
        """Release the file; may be called twice."""
        self._video.close()
