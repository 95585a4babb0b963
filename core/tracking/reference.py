"""The reference frame: the image warped by a similarity, so that experts see faces upright and at a given size."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .grey import Grey, region


@dataclass(frozen=True)
class ReferenceFrame:
    """A crop and the similarity ``reference = linear @ image + offset`` that maps the image to it.

    Attributes
    ----------
    pixels : (H, W) or (H, W, 3) uint8
        The crop.
    turn : (float, float)
        First row of `linear`; the second is the first, rotated by 90 degrees.
    shift : (float, float)
        The vector `offset`.
    """

    pixels: NDArray[np.uint8]
    turn: tuple[float, float]
    shift: tuple[float, float]

    @property
    def linear(self) -> FloatArray:
        """The matrix of the similarity, (2, 2)."""
        c, s = self.turn
        return np.array([[c, s], [-s, c]])

    @property
    def offset(self) -> FloatArray:
        """The translation of the similarity, (2,)."""
        return np.array(self.shift)

    def in_image(self, points: FloatArray) -> FloatArray:
        """Convert points (n, 2) of the crop to the image."""
        c, s = self.turn
        return np.asarray((points - self.offset) @ self.linear / (c * c + s * s))


def pose_in_image(relative: FloatArray, start: FloatArray) -> FloatArray:
    """Convert a pose (6,) from the face frame of `start` (6,), a pose in the image frame, to the image frame.

    The face frame is the image translated by the start, rotated back by its roll and divided by its scale, so that the
    start itself is ``(1, pitch, yaw, 0, 0, 0)`` there.
    """
    start_scale, _, _, start_roll, start_x, start_y = start.tolist()
    scale, pitch, yaw, roll, x, y = relative.tolist()
    c, s = start_scale * cos(start_roll), start_scale * sin(start_roll)
    place = (start_x + c * x - s * y, start_y + s * x + c * y)
    return np.array([start_scale * scale, pitch, yaw, start_roll + roll, *place])


def translate_pose(pose: FloatArray, x: float, y: float) -> FloatArray:
    """Move a pose (6,) in the image frame to the point `(x, y)` of its own face frame, in outer-eye distances."""
    return pose_in_image(np.array([1.0, pose[1], pose[2], 0.0, x, y]), pose)


def warp_to_reference(image: Grey, pose: FloatArray, scale: float, size: tuple[int, int]) -> ReferenceFrame:
    """Crop a face, upright, to `size` (width, height) in pixels, at `scale` pixels per outer-eye distance.

    The image is grey or BGR. The translation of the pose (6,), in the image frame, becomes the centre of the crop.
    Beyond the border of the image, border pixels are repeated. Only the visible part of the image is processed. If the
    face is much larger than the crop, the image is reduced by an integer factor first, as the bilinear warp would
    alias.
    """
    # Python floats, as operations on numpy scalars take ten times as long.
    pose_scale, _, _, roll, x, y = pose.tolist()
    gain = scale / pose_scale
    c, s = gain * cos(roll), gain * sin(roll)
    width, height = size
    right, down = (width - 1) / 2.0 - c * x - s * y, (height - 1) / 2.0 + s * x - c * y
    # Half the sides of the crop's bounding box in the image.
    along, across = 0.5 * abs(c) / gain**2, 0.5 * abs(s) / gain**2
    reach = (along * width + across * height + 2.0, across * width + along * height + 2.0)
    patch, step, left, top = _shrunk_region(image, x, y, reach, int(1.0 / gain))
    # Pixel centres: pixel j of the reduced image is at corner + step * j + (step - 1) / 2 in the image.
    left, top = left + (step - 1) / 2.0, top + (step - 1) / 2.0
    local = np.array(
        [
            [c * step, s * step, c * left + s * top + right],
            [-s * step, c * step, -s * left + c * top + down],
        ]
    )
    pixels = cv2.warpAffine(patch, local, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return ReferenceFrame(cast("NDArray[np.uint8]", pixels), (c, s), (right, down))


def _shrunk_region(
    image: Grey, x: float, y: float, reach: tuple[float, float], step: int
) -> tuple[NDArray[np.uint8], int, float, float]:
    """Return the part of the image within `reach` (x, y) pixels of (x, y), reduced by averaging step x step pixels.

    Also return the step that was used, and the position of the first pixel in the image.
    """
    height, width = image.shape[:2]
    left, right = _span(x, reach[0], width, step)
    top, bottom = _span(y, reach[1], height, step)
    seen = region(image, left, top, right, bottom)
    if step < 2 or min(seen.shape[:2]) < 2 * step:
        return seen, 1, left, top
    rows, columns = seen.shape[0] // step, seen.shape[1] // step
    whole = seen[: rows * step, : columns * step]
    small = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return cast("NDArray[np.uint8]", small), step, left, top


def _span(centre: float, reach: float, length: int, step: int) -> tuple[int, int]:
    """First and last (exclusive) pixel within `reach` of `centre` along an axis; at least one pixel of the image.

    The first is a multiple of `step`, so that the same pixels are averaged when a face moves.
    """
    first = int(min(max(centre - reach, 0.0), length - 1))
    first -= first % max(step, 1)
    return first, max(int(min(max(centre + reach + 1.0, 0.0), length)), first + 1)
