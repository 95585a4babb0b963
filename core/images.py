"""Pictures on disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from .capture import require_file
from .errors import OutputError, SourceError
from .files import replacing

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return the picture at `path` as (H, W, 3) uint8 BGR, turned upright by its EXIF orientation.

    Raises
    ------
    SourceError
        Where there is no such file or it is no picture.
    """
    path = Path(path)
    require_file(path)
    cv2.setLogLevel(0)
    image = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR) if path.stat().st_size else None
    if image is None:
        raise SourceError(f"{path} is not a picture that can be read. Convert it to JPEG or PNG and try again.")
    return np.asarray(image, dtype=np.uint8)


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a BGR picture in the format that the suffix of `path` names.

    Raises
    ------
    OutputError
        Where the suffix names no known format or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        raise OutputError(f"Cannot write {path}: give it the suffix .png or .jpg.")
    _, data = cv2.imencode(path.suffix, image)
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
