"""Patch experts: for each landmark a small net that tells from an 11 x 11 patch whether the landmark is there.

They have the last word. What convolutional experts find of a whole part, these put on the edge that is seen: they know
nothing but their own few pixels. Some rectified units instead of the original model's linear filter tell a shut lid
from a brow, and cost a single matrix product for all landmarks together.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from .experts import ResponseMaps
from .reference import warp_to_reference

PATCH = 11
HALF = PATCH // 2
RADIUS = 2
"""Of the search window, in pixels."""
REACH = 0.95
"""Half the side of the picture in outer-eye distances: jaw and brows of a turned face are in it."""
CONTRAST_FLOOR = 4.0
"""Grey levels. Patches flatter than this are noise, and stay small when they are normalised."""


@dataclass(frozen=True)
class PatchExperts:
    """The experts of one view at one scale: `sigmoid(c + v . relu(b + W . patch))`.

    Attributes
    ----------
    scale : float
        Pixels an outer-eye distance at which they were trained.
    hidden : (N, 121, U) float32
        `W`; each column sums to 0, so that only the contrast of a patch must be normalised.
    hidden_bias : (N, U), output : (N, U), output_bias : (N,) float32
    """

    scale: float
    hidden: NDArray[np.float32]
    hidden_bias: NDArray[np.float32]
    output: NDArray[np.float32]
    output_bias: NDArray[np.float32]

    def look(self, grey: NDArray[np.uint8], pose: FloatArray, shape: FloatArray) -> tuple[ResponseMaps, FloatArray]:
        """Maps in the face frame of `pose` (6,), in windows round landmarks `shape` (N, 2) of that frame.

        Returns them, squared and scaled to sum to 1, and each one's highest response (N,), 0 to 1. One batched product
        of (N, 25, 121) by (N, 121, U), some 6 million multiplications for N = 66, U = 32; 0.8 ms.
        """
        size = 2 * ceil(REACH * self.scale + HALF + RADIUS)
        middle = (size - 1) / 2.0
        pixels = warp_to_reference(grey, pose, self.scale, size).pixels
        centres = np.round(shape * self.scale + middle).astype(np.intp)
        likely, corner = self.responses(pixels, centres, RADIUS)
        highest = likely.max(axis=(1, 2)).astype(np.float64)
        np.square(likely, out=likely)
        likely /= np.maximum(likely.sum(axis=(1, 2), keepdims=True), np.float32(1e-20))
        count = len(shape)
        place = ((corner - middle) / self.scale).astype(np.float32)
        maps = ResponseMaps(np.arange(count), likely, place, np.full((count, 1), 1.0 / self.scale, np.float32))
        return maps, highest

    def responses(
        self, pixels: NDArray[np.float32], centres: IntArray, radius: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Responses (N, w, w) of w = 2 radius + 1 places round centres (N, 2) of a picture (S, S); rows are y.

        And the first place (N, 2) of each window: one that would leave the picture is moved inside.
        """
        side = 2 * radius + 1
        height, width = pixels.shape
        limit = np.array([width, height]) - side - PATCH + 1
        corner = np.clip(centres - radius - HALF, 0, limit)
        patches = _patches(pixels, corner, side)
        contrast = _crops(_inverse_contrast(pixels), corner + HALF, side).transpose(0, 2, 1).reshape(len(corner), -1, 1)
        units = np.matmul(patches, self.hidden)
        units *= contrast
        units += self.hidden_bias[:, None]
        np.maximum(units, 0.0, out=units)
        score = np.matmul(units, self.output[:, :, None])[..., 0] + self.output_bias[:, None]
        probability = 1.0 / (1.0 + np.exp(-score))
        by_row = probability.reshape(len(corner), side, side).transpose(0, 2, 1)
        return np.ascontiguousarray(by_row), corner + HALF

    def mirrored(self, order: IntArray) -> PatchExperts:
        """The experts of the mirrored view; `order` (N,) names each landmark's counterpart."""
        units = self.hidden.shape[2]
        flipped = self.hidden.reshape(-1, PATCH, PATCH, units)[order, :, ::-1].reshape(self.hidden.shape)
        return PatchExperts(
            self.scale,
            np.ascontiguousarray(flipped),
            self.hidden_bias[order],
            self.output[order],
            self.output_bias[order],
        )


def _inverse_contrast(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """(S, S) 1 / standard deviation of the patch round every pixel."""
    centred = pixels - pixels.mean()
    mean = cv2.blur(centred, (PATCH, PATCH))
    variance = cv2.blur(centred * centred, (PATCH, PATCH)) - mean * mean
    out: NDArray[np.float32] = 1.0 / np.sqrt(np.maximum(variance, 0.0) + np.float32(CONTRAST_FLOOR**2))
    return out


def _crops(pixels: NDArray[np.float32], corner: IntArray, side: int) -> NDArray[np.float32]:
    """(N, side, side) squares that start at corner (N, 2)."""
    steps = np.arange(side)
    rows = corner[:, 1, None] + steps
    columns = corner[:, 0, None] + steps
    out: NDArray[np.float32] = pixels[rows[:, :, None], columns[:, None, :]]
    return out


def _patches(pixels: NDArray[np.float32], corner: IntArray, side: int) -> NDArray[np.float32]:
    """(N, side * side, 121) every patch of every window, the window's columns in the outer loop.

    The columns are unfolded first: a patch is then a run of 121 numbers that starts 11 after the one above it, and
    the second copy moves long runs instead of single rows of a patch.
    """
    count, span = len(corner), side + PATCH - 1
    crops = np.ascontiguousarray(_crops(pixels - np.float32(128.0), corner, span))
    a, b, c = crops.strides
    unfolded = np.ascontiguousarray(as_strided(crops, (count, side, span, PATCH), (a, c, b, c)))
    a, b, c, d = unfolded.strides
    return as_strided(unfolded, (count, side, side, PATCH * PATCH), (a, b, c, d)).reshape(count, side * side, -1)
