"""Where another scene begins, or another photograph."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_CUT = 0.8
"""Correlation of two small images below which there was a cut between them. In 23 of 24 clips of strangers it is never
below 0.87, in the other at its three cuts only; images of different clips have less than 0.63 in 99 % of the pairs."""
_SMALL = 32
"""Side of these images in pixels."""


class CutDetector:
    """Compares each image with the one before."""

    def __init__(self) -> None:
        self._before: NDArray[np.float32] | None = None

    def is_cut(self, image: NDArray[np.uint8]) -> bool:
        """Return whether an image, (H, W) or BGR, shows another scene than the one of the previous call."""
        before, self._before = self._before, _thumbnail(image)
        return before is not None and _differ(before, self._before)


class LostScene:
    """Tells whether a face was lost by a cut to another scene, where it need not be awaited.

    Somebody who steps in front of the performer changes the image gradually, and who covers the camera uncovers the
    same scene: so there is both a cut between two images, and another scene than that of the last image with the face.

    Attributes
    ----------
    last : (H, W) or (H, W, 3) uint8 or None
        The last image with the face.
    """

    def __init__(self) -> None:
        self.last: NDArray[np.uint8] | None = None
        self._cuts = CutDetector()
        self._scene: NDArray[np.float32] | None = None
        self._was_cut = False

    def keep(self, image: NDArray[np.uint8]) -> None:
        """Remember an image with the face, (H, W) or BGR."""
        self.last, self._scene = image, None

    def is_another(self, image: NDArray[np.uint8]) -> bool:
        """Return whether an image without the face shows another scene; to be called with each since it was lost."""
        if self.last is None:
            return False
        if self._scene is None:
            self._cuts.is_cut(self.last)
            self._scene, self._was_cut = _thumbnail(self.last), False
        self._was_cut |= self._cuts.is_cut(image)
        return self._was_cut and _differ(self._scene, _thumbnail(image))


def _thumbnail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return a small grey image as a vector of length 1."""
    small = cv2.resize(image, (_SMALL, _SMALL), interpolation=cv2.INTER_AREA)
    if small.ndim == 3:
        small = cv2.cvtColor(small[..., :3], cv2.COLOR_BGR2GRAY)
    now = small.astype(np.float32).ravel()
    now -= now.mean()
    out: NDArray[np.float32] = now / max(float(np.linalg.norm(now)), 1e-3)
    return out


def _differ(before: NDArray[np.float32], now: NDArray[np.float32]) -> bool:
    return float(before @ now) < _CUT
