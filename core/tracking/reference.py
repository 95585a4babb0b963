"""The reference frame: the image warped by a similarity, so that experts see one scale and one roll."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray


@dataclass(frozen=True)
class ReferenceFrame:
    """A grey picture (S, S) float32 and the similarity `reference = linear @ image + offset` that made it."""

    pixels: NDArray[np.float32]
    linear: FloatArray
    offset: FloatArray


def pose_in_image(relative: FloatArray, start: FloatArray) -> FloatArray:
    """(6,) pose of the image frame, for a `relative` (6,) one in the face frame of `start` (6,).

    The face frame is the image moved to the start's translation, turned back by its roll and divided by its scale: the
    start itself is `(1, pitch, yaw, 0, 0, 0)` there.
    """
    c, s = start[0] * cos(start[3]), start[0] * sin(start[3])
    x, y = relative[4:6]
    place = (start[4] + c * x - s * y, start[5] + s * x + c * y)
    return np.array([start[0] * relative[0], relative[1], relative[2], start[3] + relative[3], *place])


def warp_to_reference(grey: NDArray[np.uint8], pose: FloatArray, scale: float, size: int) -> ReferenceFrame:
    """Cut the face at `pose` (6,) out of a grey image (H, W), unrolled and at `scale` pixels an outer-eye distance.

    Only the part of the image that the frame shows is touched; it is shrunk by whole pixels first where the face is
    much larger than the frame, since the bilinear warp would alias. Beyond the image the border is repeated. `size` is
    the side of the frame in pixels.
    """
    gain = scale / pose[0]
    x, y, roll = float(pose[4]), float(pose[5]), float(pose[3])
    c, s = gain * cos(roll), gain * sin(roll)
    middle = (size - 1) / 2.0
    linear = np.array([[c, s], [-s, c]])
    offset = np.array([middle - c * x - s * y, middle + s * x - c * y])
    reach = 0.5 * size * (abs(c) + abs(s)) / gain**2 + 2.0
    patch, step, left, top = _shrunk_region(grey, x, y, reach, int(1.0 / gain))
    # Pixel centres: the shrunk pixel j stands for image position corner + step * j + (step - 1) / 2.
    left, top = left + (step - 1) / 2.0, top + (step - 1) / 2.0
    local = np.array(
        [
            [c * step, s * step, c * left + s * top + offset[0]],
            [-s * step, c * step, -s * left + c * top + offset[1]],
        ]
    )
    pixels = cv2.warpAffine(patch, local, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return ReferenceFrame(pixels.astype(np.float32), linear, offset)


def _shrunk_region(
    grey: NDArray[np.uint8], x: float, y: float, reach: float, step: int
) -> tuple[NDArray[np.uint8], int, float, float]:
    """The part of the image within `reach` pixels of (x, y), every step x step pixels averaged into one.

    Returns it, the step that could be taken, and the image position of its first pixel.
    """
    height, width = grey.shape
    left, right = _span(x, reach, width)
    top, bottom = _span(y, reach, height)
    region = grey[top:bottom, left:right]
    if step < 2 or min(region.shape) < 2 * step:
        return region, 1, left, top
    rows, columns = region.shape[0] // step, region.shape[1] // step
    whole = region[: rows * step, : columns * step]
    small: NDArray[np.uint8] = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.uint8)
    return small, step, left, top


def _span(centre: float, reach: float, length: int) -> tuple[int, int]:
    """First and last pixel (exclusive) within `reach` of a place on an axis; at least one pixel of the image."""
    first = int(min(max(centre - reach, 0.0), length - 1))
    return first, max(int(min(max(centre + reach + 1.0, 0.0), length)), first + 1)
