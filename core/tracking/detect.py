"""Viola-Jones face detection with the cascades that come with OpenCV (docs/method.md, section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import ModelError

DETECTORS = ("haarcascade_frontalface_default", "haarcascade_frontalface_alt2", "haarcascade_profileface")


class Effort(IntEnum):
    """Kinds of search, in the order in which they are made: cheap and likely ones first."""

    NEAR = 0
    """Faces as large as in front of a webcam."""
    SMALL = 1
    FILLING = 2
    """Close-ups that fill the picture or are cut by its border."""
    FINE = 3
    """Also small, dim and unusual faces."""
    PROFILE = 4
    TILTED = 5
    LYING = 6
    FAR = 7
    FARTHER = 8
    """Faces far away, in images that are large enough for them."""
    ANYTHING = 9
    """Every window that a single stage of a cascade accepts; the tracker has to sort them out."""


EFFORTS = tuple(Effort)
_QUICK_SIDE = 320
_SIDES = {Effort.FILLING: 240, Effort.FINE: 480, Effort.FAR: 960, Effort.FARTHER: 1920, Effort.ANYTHING: 480}
"""Pixels to which the longer side of an image is reduced for an effort, if not `_QUICK_SIDE`."""
_SEARCHED = {Effort.FAR: _SIDES[Effort.FINE], Effort.FARTHER: _SIDES[Effort.FAR]}
"""The side that an earlier effort used: smaller images gain nothing from this one."""
_RIM = 60
"""Pixels by which the border of an image is extended for close-ups."""
_SMALLEST = 28
_FARTHEST = 72
"""Largest box in pixels of the efforts for faces far away; earlier efforts find larger ones."""
_NEAR = 72
"""Smallest box in pixels of the first effort: about a quarter of the picture, which takes a third of the time."""
_FILLING = 96
"""Smallest box in pixels of a close-up."""
_TILTS = {Effort.TILTED: (0.5, -0.5), Effort.LYING: (1.05, -1.05, 1.6, -1.6)}
"""Radians; each covers a quarter of a radian to either side."""


@dataclass(frozen=True)
class FaceBox:
    """A box in which a detector found a face.

    Attributes
    ----------
    box : (4,) float64
        `(x, y, width, height)`, pixels. If the image was rotated, only the centre and the size are meaningful.
    detector : int
        Index into `DETECTORS`.
    roll : float
        Radians by which the image was rotated back for the detector.
    """

    box: FloatArray
    detector: int
    roll: float = 0.0

    def start_pose(self, offsets: FloatArray) -> FloatArray:
        """(6,) frontal pose from the learnt offsets (D, 3) of the detectors: translation and scale in box widths."""
        dx, dy, scale = offsets[self.detector]
        x, y, width, height = self.box
        place = (x + width * (0.5 + dx), y + 0.5 * height + width * dy)
        return np.array([scale * width, 0.0, 0.0, self.roll, *place])


class BoxDetector:
    """Proposes boxes that may contain faces; the tracker fits and checks them."""

    @cached_property
    def _cascades(self) -> list[cv2.CascadeClassifier]:
        folder = Path(cv2.__file__).parent / "data"
        cascades = [cv2.CascadeClassifier(str(folder / f"{name}.xml")) for name in DETECTORS]
        if any(c.empty() for c in cascades):
            raise ModelError(
                f"OpenCV's face cascades are missing from {folder}. Install opencv-contrib-python-headless."
            )
        return cascades

    def boxes(self, grey: NDArray[np.uint8], effort: Effort) -> list[FaceBox]:
        """Detect boxes that may contain faces.

        Parameters
        ----------
        grey : (H, W) uint8
            Grey image.
        effort : Effort
            One of `EFFORTS`.

        Returns
        -------
        list of FaceBox
            Largest first.

        Notes
        -----
        An effort takes 4 to 100 ms at 640 x 480. The first one finds most faces.
        """
        plain, factor = _shrink(grey, _SIDES.get(effort, _QUICK_SIDE))
        if min(plain.shape) < _SMALLEST or max(grey.shape) <= _SEARCHED.get(effort, 0):
            return []
        found = self._found(plain, effort)
        distinct = _distinct([FaceBox(f.box * factor, f.detector, f.roll) for f in found])
        return sorted(distinct, key=lambda f: -f.box[2])

    def _found(self, plain: NDArray[np.uint8], effort: Effort) -> list[FaceBox]:
        even = cv2.equalizeHist(plain).astype(np.uint8)
        if effort == Effort.NEAR:
            return [FaceBox(b, 1) for b in self._run(even, 1, neighbours=3, smallest=_NEAR)]
        if effort == Effort.SMALL:
            return [FaceBox(b, 1) for b in self._run(even, 1, neighbours=3, largest=_NEAR)]
        if effort == Effort.FILLING:
            drawn = cv2.copyMakeBorder(even, _RIM, _RIM, _RIM, _RIM, cv2.BORDER_REPLICATE).astype(np.uint8)
            return [FaceBox(b - (_RIM, _RIM, 0, 0), 1) for b in self._run(drawn, 1, neighbours=3, smallest=_FILLING)]
        if effort in _SEARCHED:
            return [FaceBox(b, 1) for b in self._run(even, 1, neighbours=2, largest=_FARTHEST, growth=1.2)]
        if effort == Effort.PROFILE:
            return self._profiles(even)
        if effort in _TILTS:
            return [b for roll in _TILTS[effort] for b in self._tilted(even, roll)]
        local = cv2.createCLAHE(4.0, (6, 6)).apply(plain).astype(np.uint8)
        if effort == Effort.FINE:
            found = [FaceBox(b, 0) for b in self._run(even, 0, neighbours=2)]
            return found + [FaceBox(b, 1) for b in self._run(local, 1, neighbours=1)]
        seen = [(d, b) for d in (0, 1) for picture in (plain, local) for b in self._run(picture, d, neighbours=0)]
        return [FaceBox(b, d) for d, b in seen]

    def _run(
        self,
        grey: NDArray[np.uint8],
        detector: int,
        neighbours: int,
        smallest: int = _SMALLEST,
        largest: int = 0,
        growth: float = 1.12,
    ) -> list[FloatArray]:
        cascade, limits = self._cascades[detector], ((smallest, smallest), (largest, largest))
        boxes = cascade.detectMultiScale(grey, growth, neighbours, minSize=limits[0], maxSize=limits[1])
        return [np.array(b, np.float64) for b in boxes]

    def _profiles(self, grey: NDArray[np.uint8]) -> list[FaceBox]:
        flipped = np.ascontiguousarray(grey[:, ::-1])
        boxes = [FaceBox(b, 2) for b in self._run(grey, 2, 2)]
        for b in self._run(flipped, 2, 2):
            boxes.append(FaceBox(np.array([grey.shape[1] - b[0] - b[2], *b[1:]]), 2))
        return boxes

    def _tilted(self, grey: NDArray[np.uint8], roll: float) -> list[FaceBox]:
        height, width = grey.shape
        middle = ((width - 1) / 2.0, (height - 1) / 2.0)
        forth = cv2.getRotationMatrix2D(middle, float(np.degrees(roll)), 1.0)
        turned = cv2.warpAffine(grey, forth, (width, height)).astype(np.uint8)
        back = cv2.invertAffineTransform(forth)
        out = []
        for x, y, w, h in self._run(turned, 1, 3):
            cx, cy = back @ np.array([x + w / 2, y + h / 2, 1.0])
            out.append(FaceBox(np.array([cx - w / 2, cy - h / 2, w, h]), 1, roll))
        return out


def _shrink(grey: NDArray[np.uint8], side: int) -> tuple[NDArray[np.uint8], float]:
    factor = max(max(grey.shape) / side, 1.0)
    size = (max(round(grey.shape[1] / factor), 1), max(round(grey.shape[0] / factor), 1))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.uint8) if factor > 1.0 else grey
    return small, factor


def _distinct(boxes: list[FaceBox]) -> list[FaceBox]:
    """Remove boxes that repeat the position, size and roll of an earlier one."""
    kept: list[FaceBox] = []
    for candidate in boxes:
        x, y, w, _ = candidate.box
        centre = np.array([x + w / 2, y + candidate.box[3] / 2])
        repeated = any(
            np.abs(centre - k.box[:2] - k.box[2:] / 2).max() < 0.15 * k.box[2]
            and 0.8 < w / k.box[2] < 1.25
            and abs(candidate.roll - k.roll) < 0.3
            for k in kept
        )
        if not repeated:
            kept.append(candidate)
    return kept
