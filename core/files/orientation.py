"""The orientation in which a WebP image is to be shown, as OpenCV reads it of other formats only."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

_ORIENTATION, _SHORT = 0x0112, 3
_UPRIGHT = 1
_TURNS = {
    3: cv2.ROTATE_180,
    4: cv2.ROTATE_180,
    5: cv2.ROTATE_90_COUNTERCLOCKWISE,
    6: cv2.ROTATE_90_CLOCKWISE,
    7: cv2.ROTATE_90_CLOCKWISE,
    8: cv2.ROTATE_90_COUNTERCLOCKWISE,
}
"""How the images of EXIF's orientations are rotated, after those in `_MIRRORED` were mirrored."""
_MIRRORED = {2, 4, 5, 7}
"""Orientations whose images are mirrored from left to right first."""


def webp_orientation(data: bytes) -> int:
    """Return EXIF's orientation of a WebP image, 1 to 8; 1, which is upright, if it states none or is damaged."""
    place = 12
    try:
        while place + 8 <= len(data):
            name, length = struct.unpack_from("<4sI", data, place)
            if name == b"EXIF":
                return _stated(data[place + 8 : place + 8 + length].removeprefix(b"Exif\0\0"))
            place += 8 + length + length % 2
    except struct.error:
        return _UPRIGHT
    return _UPRIGHT


def _stated(tiff: bytes) -> int:
    order = ">" if tiff.startswith(b"MM") else "<"
    (start,) = struct.unpack_from(order + "I", tiff, 4)
    (count,) = struct.unpack_from(order + "H", tiff, start)
    for entry in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind, _, value = struct.unpack_from(order + "HHIH", tiff, entry)
        if tag == _ORIENTATION and kind == _SHORT:
            return value if 1 <= value <= 8 else _UPRIGHT
    return _UPRIGHT


def oriented(image: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Return an image (H, W, ...) as it is to be shown by EXIF's orientation."""
    if orientation in _MIRRORED:
        image = np.asarray(cv2.flip(image, 1), dtype=np.uint8)
    if orientation in _TURNS:
        image = np.asarray(cv2.rotate(image, _TURNS[orientation]), dtype=np.uint8)
    return image
