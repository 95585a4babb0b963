"""Patch experts: for each landmark a small net that tells from an 11 x 11 patch whether the landmark is there.

A linear filter, the original constrained local model's expert, cannot tell a shut eye from a brow or a lip from a
shadow; some rectified units can, and cost a single matrix product for all landmarks together.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ..arrays import IntArray

PATCH = 11
HALF = PATCH // 2
CONTRAST_FLOOR = 4.0
"""Grey levels. Patches flatter than this are noise, and stay small when they are normalised."""


@dataclass(frozen=True)
class ResponseMaps:
    """How likely each landmark is at each place of its search window.

    Attributes
    ----------
    probability : (N, w, w) float32
        Rows are y.
    corner : (N, 2) int
        Position (x, y) of each window's first pixel in the reference frame.
    """

    probability: NDArray[np.float32]
    corner: IntArray


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

    def response_maps(self, pixels: NDArray[np.float32], centres: IntArray, radius: int) -> ResponseMaps:
        """Responses in windows of side w = 2 radius + 1 round centres (N, 2) of a reference picture (S, S).

        A window that would leave the picture is moved inside. One batched product of (N, w * w, 121) by
        (N, 121, U), about 60 million multiplications for N = 66, w = 11, U = 32.
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
        return ResponseMaps(np.ascontiguousarray(by_row), corner + HALF)

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
