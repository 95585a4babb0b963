"""Reading and writing of image files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError, SourceError
from ..files.reading import read_bytes
from ..files.writing import replacing
from ..numeric.opencv import silence_opencv
from .capture import require_file
from .picture_size import stated_size

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})


MAX_PIXELS = 100_000_000
"""Largest number of pixels: an image of 16,384 pixels per side takes two gigabytes and 15 seconds."""
MAX_SIDE = 30_000
"""Largest number of pixels per side; OpenCV cannot warp more than 32,767."""
_MAX_FILE = 1 << 30


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8 BGR, rotated upright according to EXIF.

    Raises
    ------
    SourceError
        If there is no such file, or it is not an image, or exceeds `MAX_PIXELS` or `MAX_SIDE`.
    """
    path = Path(path)
    require_file(path)
    silence_opencv()
    try:
        data = read_bytes(path, _MAX_FILE)
        size = stated_size(data)
        if size is not None and (max(size) > MAX_SIDE or size[0] * size[1] > MAX_PIXELS):
            raise SourceError(
                "{path} is {width} x {height} pixels; the limit is {max_pixels} megapixels "
                "and {max_side} pixels per side. Scale it down and try again.",
                path=path,
                width=size[0],
                height=size[1],
                max_pixels=MAX_PIXELS // 10**6,
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
    """Write an image in the format given by the suffix.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR.

    Raises
    ------
    OutputError
        If the suffix is unknown, the image is too large for the format, or the file cannot be written.
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
