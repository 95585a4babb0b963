"""Pictures on disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from .capture import require_file
from .errors import OutputError, SourceError
from .files import replacing
from .picture_size import stated_size
from .reading import read_bytes

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})


MAX_PIXELS, MAX_SIDE = 100_000_000, 30_000
"""Of a picture that is read: a picture of 16,384 pixels to a side takes two gigabytes and a quarter of a minute, and
OpenCV warps none of more than 32,767."""
_MOST_FILE = 1 << 30


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return the picture at `path` as (H, W, 3) uint8 BGR, turned upright by its EXIF orientation.

    Raises
    ------
    SourceError
        Where there is no such file, it is no picture, or one of more than `MAX_PIXELS` or `MAX_SIDE`.
    """
    path = Path(path)
    require_file(path)
    cv2.setLogLevel(0)
    try:
        data = read_bytes(path, _MOST_FILE)
        size = stated_size(data)
        if size is not None and (max(size) > MAX_SIDE or size[0] * size[1] > MAX_PIXELS):
            raise SourceError(
                f"{path} is {size[0]} x {size[1]} pixels; the limit is {MAX_PIXELS // 10**6} megapixels "
                f"and {MAX_SIDE} pixels a side. Make it smaller and try again."
            )
        image = None if size is None else cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except (OSError, ValueError, cv2.error) as error:
        raise _unreadable(path) from error
    if image is None:
        raise _unreadable(path)
    return np.asarray(image, dtype=np.uint8)


def _unreadable(path: Path) -> SourceError:
    return SourceError(f"{path} is not a picture that can be read. Convert it to JPEG or PNG and try again.")


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a BGR picture in the format that the suffix of `path` names.

    Raises
    ------
    OutputError
        Where the suffix names no known format, the picture is too large for it, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        raise OutputError(f"Cannot write {path}: give it the suffix .png or .jpg.")
    try:
        done, data = cv2.imencode(path.suffix, image)
    except cv2.error:  # some formats raise where others return False
        done = False
    if not done:
        height, width = image.shape[:2]
        raise OutputError(
            f"Cannot write {path}: a {path.suffix} file cannot hold {width} x {height} pixels. Give it the suffix .png."
        )
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
