"""Where frames come from: a video file or a still image, each frame with the time that the media itself states.

A frame's time is its presentation time in the container, not its number over the nominal rate: recordings from phones
and webcams have a variable rate, and animation timed by counting runs out of step with their sound.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import SourceError

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})


@dataclass(frozen=True)
class Frame:
    """One frame: `image` (H, W, 3) uint8 BGR, `time` in seconds from the first frame, `index` from 0."""

    image: NDArray[np.uint8]
    time: float
    index: int


class VideoSource:
    """The frames of a video file, in order; a context manager and an iterator of `Frame`.

    Parameters
    ----------
    path : Path
        Anything that OpenCV's FFmpeg reads: H.264, HEVC, MPEG-4, VP8/9, MJPEG; not AV1.

    Attributes
    ----------
    fps : float
        The nominal rate, frames a second; 25 where the file states none.
    frame_count : int
        The stated number of frames, 0 where unknown. Not to be relied on: containers err.

    Raises
    ------
    SourceError
        Where there is no such file, it is no video, or not one frame of it can be decoded.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        _require_file(self.path)
        cv2.setLogLevel(0)
        self._capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise SourceError(f"{self.path} is not a video that can be read. Convert it to MP4 (H.264) and try again.")
        fps = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.fps = fps if np.isfinite(fps) and 1.0 <= fps <= 1000.0 else 25.0
        self.frame_count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))

    def __iter__(self) -> Iterator[Frame]:
        start = previous = None
        index = 0
        while True:
            read, image = self._capture.read()
            if not read or image is None:
                break
            stamp = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
            if previous is not None and not stamp > previous:
                stamp = previous + 1.0 / self.fps
            start = stamp if start is None else start
            previous = stamp
            yield Frame(np.asarray(image, dtype=np.uint8), stamp - start, index)
            index += 1
        if index == 0:
            raise SourceError(
                f"No frame of {self.path} can be decoded: it is empty, broken, or in an unsupported codec such as AV1. "
                "Convert it to MP4 (H.264) and try again."
            )

    def close(self) -> None:
        """Release the file; may be called twice."""
        self._capture.release()

    def __enter__(self) -> VideoSource:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return the image at `path` as (H, W, 3) uint8 BGR, turned upright by its EXIF orientation.

    Raises
    ------
    SourceError
        Where there is no such file or it is no image.
    """
    path = Path(path)
    _require_file(path)
    cv2.setLogLevel(0)
    image = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR) if path.stat().st_size else None
    if image is None:
        raise SourceError(f"{path} is not an image that can be read. Convert it to JPEG or PNG and try again.")
    return np.asarray(image, dtype=np.uint8)


def _require_file(path: Path) -> None:
    if not path.exists():
        raise SourceError(f"There is no file {path}. Check the path.")
    if not path.is_file():
        raise SourceError(f"{path} is not a file. Give the path of a file.")
    if not os.access(path, os.R_OK):
        raise SourceError(f"{path} cannot be read: no permission. Change its permissions or copy it elsewhere.")
