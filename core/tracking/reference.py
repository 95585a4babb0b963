"""The reference frame: the image warped by a similarity, so that experts see one scale and one roll."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, sin

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

REACH = 1.35
"""Half the side of the frame in outer-eye distances: a face with its jaw dropped still fits in."""
_MARGIN = 14


@dataclass(frozen=True)
class ReferenceFrame:
    """A grey picture (S, S) float32 and the similarity `reference = linear @ image + offset` that made it."""

    pixels: NDArray[np.float32]
    linear: FloatArray
    offset: FloatArray

    def pose_to_reference(self, pose: FloatArray) -> FloatArray:
        """(6,) pose of the image frame, seen in this frame."""
        gain, turn = self._gain_and_turn()
        return np.array([pose[0] * gain, pose[1], pose[2], pose[3] + turn, *(self.linear @ pose[4:6] + self.offset)])

    def pose_to_image(self, pose: FloatArray) -> FloatArray:
        """(6,) pose of this frame, seen in the image frame."""
        gain, turn = self._gain_and_turn()
        translation = self.linear.T @ (pose[4:6] - self.offset) / gain**2
        return np.array([pose[0] / gain, pose[1], pose[2], pose[3] - turn, *translation])

    def _gain_and_turn(self) -> tuple[float, float]:
        return float(np.hypot(*self.linear[:, 0])), float(np.arctan2(self.linear[1, 0], self.linear[0, 0]))


def frame_size(scale: float) -> int:
    """Side in pixels of the frame that shows a face of `scale` pixels an outer-eye distance."""
    return 2 * ceil(REACH * scale + _MARGIN)


def warp_to_reference(
    grey: NDArray[np.uint8], pose: FloatArray, scale: float, size: int | None = None
) -> ReferenceFrame:
    """Cut the face at `pose` (6,) out of a grey image (H, W), unrolled and at `scale` pixels an outer-eye distance.

    Only the part of the image that the frame shows is touched; it is shrunk by whole pixels first where the face is
    much larger than the frame, since the bilinear warp would alias. Beyond the image the border is repeated. `size` is
    the side of the frame in pixels, by default that of the patch experts.
    """
    size = frame_size(scale) if size is None else size
    gain = scale / pose[0]
    c, s = gain * cos(pose[3]), gain * sin(pose[3])
    linear = np.array([[c, s], [-s, c]])
    offset = (size - 1) / 2.0 - linear @ pose[4:6]
    patch, step, corner = _shrunk_region(grey, pose, size / gain, int(1.0 / gain))
    # Pixel centres: the shrunk pixel j stands for image position corner + step * j + (step - 1) / 2.
    local = np.column_stack([linear * step, linear @ (corner + (step - 1) / 2.0) + offset])
    pixels = cv2.warpAffine(patch, local, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return ReferenceFrame(pixels.astype(np.float32), linear, offset)


def _shrunk_region(
    grey: NDArray[np.uint8], pose: FloatArray, side: float, step: int
) -> tuple[NDArray[np.uint8], int, FloatArray]:
    """The part of the image within `side` pixels round the pose, every step x step pixels averaged into one."""
    height, width = grey.shape
    reach = 0.75 * side + 2.0
    x0, y0 = (int(np.clip(v - reach, 0, n - 1)) for v, n in zip(pose[4:6], (width, height), strict=True))
    x1, y1 = (int(np.clip(v + reach, 0, n)) for v, n in zip(pose[4:6], (width, height), strict=True))
    region = grey[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)]
    corner = np.array([x0, y0], np.float64)
    if step < 2 or min(region.shape) < 2 * step:
        return region, 1, corner
    rows, columns = region.shape[0] // step, region.shape[1] // step
    whole = region[: rows * step, : columns * step]
    small: NDArray[np.uint8] = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.uint8)
    return small, step, corner
