"""Images in grey, which are converted only where they are looked at."""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

_ROOM = 0.25
"""Share of the size of a region by which more is converted on each side, as the next ones lie about the same face."""


class GreyImage:
    """A BGR image (H, W, 3) in grey.

    A followed face is a small part of a frame: converting all of a frame of 1280 x 720 takes an eighth of the time that
    tracking takes.
    """

    def __init__(self, pixels: NDArray[np.uint8]) -> None:
        self._pixels = pixels
        height, width = pixels.shape[:2]
        self.shape = (height, width)
        self._grey = np.empty(self.shape, np.uint8)
        self._known = (width, height, 0, 0)

    def region(self, left: int, top: int, right: int, bottom: int) -> NDArray[np.uint8]:
        """Return a region, with the last column and row exclusive."""
        first, upper, last, lower = self._known
        if left < first or top < upper or right > last or bottom > lower:
            height, width = self.shape
            across, down = int(_ROOM * (right - left)), int(_ROOM * (bottom - top))
            first, upper = min(max(left - across, 0), first), min(max(top - down, 0), upper)
            last, lower = max(min(right + across, width), last), max(min(bottom + down, height), lower)
            here = np.s_[upper:lower, first:last]
            cv2.cvtColor(self._pixels[here], cv2.COLOR_BGR2GRAY, self._grey[here])
            self._known = first, upper, last, lower
        return self._grey[top:bottom, left:right]

    def whole(self) -> NDArray[np.uint8]:
        """Return the whole image."""
        return self.region(0, 0, self.shape[1], self.shape[0])


Grey: TypeAlias = "NDArray[np.uint8] | GreyImage"
"""An image in grey, (H, W)."""


def whole(grey: Grey) -> NDArray[np.uint8]:
    """Return a whole image."""
    return grey.whole() if isinstance(grey, GreyImage) else grey


def region(image: Grey, left: int, top: int, right: int, bottom: int) -> NDArray[np.uint8]:
    """Return a region of an image in grey, or of a BGR image (H, W, 3)."""
    return image.region(left, top, right, bottom) if isinstance(image, GreyImage) else image[top:bottom, left:right]
