"""Viola-Jones face detection with the cascades that OpenCV ships (method.md, section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..numeric.arrays import FloatArray

DETECTORS = ("haarcascade_frontalface_default", "haarcascade_frontalface_alt2", "haarcascade_profileface")


class Effort(IntEnum):
    """Kinds of search, in the order in which they are made: the cheap and likely ones first."""

    NEAR = 0
    """Faces about as large as in front of a webcam."""
    SMALL = 1
    FILLING = 2
    """Close-ups that fill the image or are cut by its border."""
    FINE = 3
    """Small, dim and unusual faces, too."""
    PROFILE = 4
    TILTED = 5
    LYING = 6
    FAR = 7
    FARTHER = 8
    """Faces far away, in images that are large enough for them."""
    ANYTHING = 9
    """Every window that a single stage of a cascade accepts; the tracker rejects the false ones."""


EFFORTS = tuple(Effort)
_QUICK_SIDE = 320
_SIDES = {Effort.FILLING: 240, Effort.FINE: 480, Effort.FAR: 960, Effort.FARTHER: 1920, Effort.ANYTHING: 480}
"""Pixels to which the longer side of an image is reduced for an effort; `_QUICK_SIDE` for all others."""
_SEARCHED = {Effort.FAR: _SIDES[Effort.FINE], Effort.FARTHER: _SIDES[Effort.FAR]}
"""The side that an earlier effort has used. Images that are not larger gain nothing from this effort."""
_RIM = 60
"""Pixels by which the border of an image is extended for close-ups."""
_SMALLEST = 28
_FARTHEST = 72
"""Largest box in pixels of the efforts for faces far away; earlier efforts find larger ones."""
_NEAR = 72
"""Smallest box of the first effort in pixels, about a quarter of the image; this reduces the time to a third."""
_FILLING = 96
"""Smallest box of a close-up in pixels."""


class Preparation(Enum):
    """How the image is prepared for a cascade."""

    PLAIN = 0
    EVEN = 1
    """Histogram equalised."""
    LOCAL = 2
    """Histogram equalised locally, with limited contrast."""
    FLIPPED = 3
    """As `EVEN`, and mirrored."""
    RIMMED = 4
    """As `EVEN`, with an extended border."""


@dataclass(frozen=True)
class Scan:
    """A run of a cascade over an image.

    Attributes
    ----------
    detector : int
        Index into `DETECTORS`.
    neighbours : int
        Number of overlapping windows that have to agree.
    smallest, largest : int
        Sides of the windows in pixels; 0 for no upper limit.
    growth : float
        Ratio of successive sides.
    picture : Preparation
        How the image is prepared.
    roll : float
        Angle in radians by which the image is rotated back first.
    """

    detector: int = 1
    neighbours: int = 3
    smallest: int = _SMALLEST
    largest: int = 0
    growth: float = 1.12
    picture: Preparation = Preparation.EVEN
    roll: float = 0.0

    def split(self, sides: Sequence[int]) -> list[Scan]:
        """Split into scans of ranges of sizes that end at the given sides, in pixels."""
        bounds = [self.smallest, *sides, self.largest]
        return [replace(self, smallest=low, largest=high) for low, high in pairwise(bounds)]


_FAR = Scan(neighbours=2, largest=_FARTHEST, growth=1.2)
SCANS: dict[Effort, tuple[Scan, ...]] = {
    Effort.NEAR: (Scan(smallest=_NEAR),),
    Effort.SMALL: (Scan(largest=_NEAR),),
    Effort.FILLING: (Scan(smallest=_FILLING, picture=Preparation.RIMMED),),
    Effort.FINE: (Scan(0, 2), Scan(1, 1, picture=Preparation.LOCAL)),
    Effort.PROFILE: (Scan(2, 2), Scan(2, 2, picture=Preparation.FLIPPED)),
    # Radians; each covers a quarter of a radian to either side.
    Effort.TILTED: tuple(Scan(roll=roll) for roll in (0.5, -0.5)),
    Effort.LYING: tuple(Scan(roll=roll) for roll in (1.05, -1.05, 1.6, -1.6)),
    Effort.FAR: (_FAR,),
    Effort.FARTHER: (_FAR,),
    Effort.ANYTHING: tuple(
        Scan(d, 0, picture=picture) for d in (0, 1) for picture in (Preparation.PLAIN, Preparation.LOCAL)
    ),
}
"""The scans of each effort."""
_SPLITS: dict[Effort, tuple[int, ...]] = {
    Effort.FINE: (36, 60),
    Effort.FAR: (33, 45),
    Effort.FARTHER: (33, 45),
    Effort.ANYTHING: (40,),
}
"""Sides in pixels at which the longest scans are split, so that each part takes at most about 15 ms."""


@dataclass(frozen=True)
class Step:
    """An effort, or one of its short scans, which a gradual search spreads over frames."""

    effort: Effort
    scans: tuple[Scan, ...]

    @classmethod
    def whole(cls, effort: Effort) -> Step:
        """Return an effort as a single step."""
        return cls(effort, SCANS[effort])

    @classmethod
    def parts(cls, effort: Effort) -> list[Step]:
        """Return an effort as a step per scan."""
        return [cls(effort, (part,)) for scan in SCANS[effort] for part in scan.split(_SPLITS.get(effort, ()))]


@dataclass(frozen=True)
class FaceBox:
    """A box in which a detector found a face.

    Attributes
    ----------
    box : (4,) float64
        `(x, y, width, height)` in pixels. If the image was rotated, only the centre and the size are meaningful.
    detector : int
        Index into `DETECTORS`.
    roll : float
        Angle in radians by which the image was rotated back for the detector.
    """

    box: FloatArray
    detector: int
    roll: float = 0.0

    def start_pose(self, offsets: FloatArray) -> FloatArray:
        """Return the frontal pose (6,) by the detectors' learnt offsets (D, 3): translation and scale in box widths."""
        dx, dy, scale = offsets[self.detector]
        x, y, width, height = self.box
        place = (x + width * (0.5 + dx), y + 0.5 * height + width * dy)
        return np.array([scale * width, 0.0, 0.0, self.roll, *place])


class CascadeDetector:
    """Proposes boxes that may contain faces, which the tracker fits and checks."""

    @cached_property
    def _cascades(self) -> list[cv2.CascadeClassifier]:
        folder = Path(cv2.__file__).parent / "data"
        cascades = [cv2.CascadeClassifier(str(folder / f"{name}.xml")) for name in DETECTORS]
        if any(c.empty() for c in cascades):
            raise ModelError(
                "OpenCV's face cascades are missing from {folder}. Install opencv-contrib-python-headless.",
                folder=folder,
            )
        return cascades

    def boxes(self, grey: NDArray[np.uint8], step: Step) -> list[FaceBox]:
        """Detect boxes that may contain faces in a grey image (H, W), the largest first.

        A whole effort takes 2 to 110 ms. The first one finds most faces.
        """
        plain, factor = _shrink(grey, _SIDES.get(step.effort, _QUICK_SIDE))
        if min(plain.shape) < _SMALLEST or max(grey.shape) <= _SEARCHED.get(step.effort, 0):
            return []
        prepared: dict[Preparation, NDArray[np.uint8]] = {}
        found = []
        for scan in step.scans:
            if scan.picture not in prepared:
                prepared[scan.picture] = _prepared(plain, scan.picture)
            found += self._scanned(prepared[scan.picture], scan)
        distinct = _distinct([FaceBox(f.box * factor, f.detector, f.roll) for f in found])
        return sorted(distinct, key=lambda f: -f.box[2])

    def _scanned(self, picture: NDArray[np.uint8], scan: Scan) -> list[FaceBox]:
        """Scan a prepared image; the boxes are in pixels of the image before it was prepared."""
        turned, back = _turned(picture, scan.roll)
        cascade, limits = self._cascades[scan.detector], [(side, side) for side in (scan.smallest, scan.largest)]
        out = []
        for found in cascade.detectMultiScale(
            turned, scan.growth, scan.neighbours, minSize=limits[0], maxSize=limits[1]
        ):
            x, y, w, h = (float(v) for v in found)
            if scan.picture is Preparation.FLIPPED:
                x = picture.shape[1] - x - w
            elif scan.picture is Preparation.RIMMED:
                x, y = x - _RIM, y - _RIM
            if scan.roll:
                cx, cy = back @ np.array([x + w / 2, y + h / 2, 1.0])
                x, y = cx - w / 2, cy - h / 2
            out.append(FaceBox(np.array([x, y, w, h]), scan.detector, scan.roll))
        return out


def _prepared(plain: NDArray[np.uint8], picture: Preparation) -> NDArray[np.uint8]:
    if picture is Preparation.PLAIN:
        return plain
    if picture is Preparation.LOCAL:
        return cv2.createCLAHE(4.0, (6, 6)).apply(plain).astype(np.uint8)
    even = cv2.equalizeHist(plain).astype(np.uint8)
    if picture is Preparation.FLIPPED:
        return np.ascontiguousarray(even[:, ::-1])
    if picture is Preparation.RIMMED:
        return cv2.copyMakeBorder(even, _RIM, _RIM, _RIM, _RIM, cv2.BORDER_REPLICATE).astype(np.uint8)
    return even


def _turned(picture: NDArray[np.uint8], roll: float) -> tuple[NDArray[np.uint8], FloatArray]:
    """Rotate an image about its centre by `roll` radians; also return the (2, 3) matrix of the way back."""
    if not roll:
        return picture, np.eye(2, 3)
    height, width = picture.shape
    middle = ((width - 1) / 2.0, (height - 1) / 2.0)
    forth = cv2.getRotationMatrix2D(middle, float(np.degrees(roll)), 1.0)
    turned = cv2.warpAffine(picture, forth, (width, height)).astype(np.uint8)
    return turned, np.asarray(cv2.invertAffineTransform(forth))


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
