"""Viola-Jones face boxes from the cascades that come with OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import ModelError

DETECTORS = ("haarcascade_frontalface_default", "haarcascade_frontalface_alt2")
_QUICK_SIDE, _FINE_SIDE = 320, 480
"""Pixels to which the longer side of an image is shrunk before it is searched."""
_SMALLEST = 28


@dataclass(frozen=True)
class FaceBox:
    """Where a detector saw a face.

    Attributes
    ----------
    box : (4,) float64
        `(x, y, width, height)`, pixels.
    detector : int
        Index into `DETECTORS`.
    """

    box: FloatArray
    detector: int

    def start_pose(self, offsets: FloatArray) -> FloatArray:
        """(6,) frontal pose, by each detector's learnt offset (D, 3) of translation and scale in box widths."""
        dx, dy, scale = offsets[self.detector]
        x, y, width, height = self.box
        return np.array([scale * width, 0.0, 0.0, 0.0, x + width * (0.5 + dx), y + 0.5 * height + width * dy])


class BoxDetector:
    """Proposes faces; the tracker tries and judges them."""

    @cached_property
    def _cascades(self) -> list[cv2.CascadeClassifier]:
        folder = Path(cv2.__file__).parent / "data"
        cascades = [cv2.CascadeClassifier(str(folder / f"{name}.xml")) for name in DETECTORS]
        if any(c.empty() for c in cascades):
            raise ModelError(
                f"OpenCV's face cascades are missing from {folder}. Install opencv-contrib-python-headless."
            )
        return cascades

    def boxes(self, grey: NDArray[np.uint8], fine: bool) -> list[FaceBox]:
        """Boxes in the grey image (H, W), largest first.

        At 640 x 480 some 10 ms for faces as a camera mostly shows them, 50 ms where `fine` looks for small, dim and odd
        ones too.
        """
        plain, factor = _shrink(grey, _FINE_SIDE if fine else _QUICK_SIDE)
        if min(plain.shape) < _SMALLEST:
            return []
        even = cv2.equalizeHist(plain).astype(np.uint8)
        if fine:
            local = cv2.createCLAHE(4.0, (6, 6)).apply(plain).astype(np.uint8)
            found = [FaceBox(b, 0) for b in self._run(even, 0, neighbours=2)]
            found += [FaceBox(b, 1) for b in self._run(local, 1, neighbours=1)]
        else:
            found = [FaceBox(b, 1) for b in self._run(even, 1, neighbours=3)]
        distinct = _distinct([FaceBox(f.box * factor, f.detector) for f in found])
        return sorted(distinct, key=lambda f: -f.box[2])

    def _run(self, grey: NDArray[np.uint8], detector: int, neighbours: int) -> list[FloatArray]:
        size = (_SMALLEST, _SMALLEST)
        boxes = self._cascades[detector].detectMultiScale(grey, 1.12, neighbours, minSize=size)
        return [np.array(b, np.float64) for b in boxes]


def _shrink(grey: NDArray[np.uint8], side: int) -> tuple[NDArray[np.uint8], float]:
    factor = max(max(grey.shape) / side, 1.0)
    size = (max(round(grey.shape[1] / factor), 1), max(round(grey.shape[0] / factor), 1))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.uint8) if factor > 1.0 else grey
    return small, factor


def _distinct(boxes: list[FaceBox]) -> list[FaceBox]:
    """Without those that repeat an earlier one's place and size."""
    kept: list[FaceBox] = []
    for candidate in boxes:
        x, y, w, _ = candidate.box
        centre = np.array([x + w / 2, y + candidate.box[3] / 2])
        repeated = any(
            np.abs(centre - k.box[:2] - k.box[2:] / 2).max() < 0.15 * k.box[2] and 0.8 < w / k.box[2] < 1.25
            for k in kept
        )
        if not repeated:
            kept.append(candidate)
    return kept
