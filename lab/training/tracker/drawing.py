"""Lines that are drawn onto training images."""

from __future__ import annotations

import cv2
import numpy as np

_SUBPIXEL = 4
"""Fractional bits of the coordinates that are drawn."""


def line(mask: np.ndarray, points: np.ndarray, thickness: int) -> None:
    """Draw a smooth white line through points (n, 2) in pixels onto a mask (H, W) uint8, in place."""
    at = np.round(points * 2**_SUBPIXEL).astype(np.int32)
    cv2.polylines(mask, [at], False, 255, thickness, cv2.LINE_AA, _SUBPIXEL)
