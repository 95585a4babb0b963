"""Patch experts: for each landmark a small net that tells from an 11 x 11 patch whether the landmark is there.

They have the last word. What convolutional experts find of a whole part, these put on the edge that is seen: they know
nothing but their own few pixels. Some rectified units instead of the original model's linear filter tell a shut lid
from a brow, and cost a single matrix product for all landmarks together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from .experts import ResponseMaps
from .reference import moved, warp_to_reference

PATCH = 11
HALF = PATCH // 2
RADIUS = 2
"""Of the search window, in pixels."""
REACH = 0.95
"""Outer-eye distances from the pose's own place beyond which nothing is looked for: jaw and brows of any face are
nearer."""
_GREY = np.float32(128.0)
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

        Returns them, squared, and each one's highest response (N,), 0 to 1. One batched product of (N, 25, 122) by
        (N, 122, U), some 6 million multiplications for N = 66, U = 32; 0.4 ms.
        """
        # Whole pixels from the pose's own place, so that a blink, which moves the box, leaves them where they are.
        centres = np.round(np.minimum(np.maximum(shape, -REACH), REACH) * self.scale).astype(np.intp)
        first = centres.min(axis=0) - (HALF + RADIUS)
        size = centres.max(axis=0) + (HALF + RADIUS + 1) - first
        middle = ((first + (size - 1) / 2.0) / self.scale).tolist()
        width, height = size.tolist()
        pixels = warp_to_reference(grey, moved(pose, *middle), self.scale, (width, height)).pixels
        likely, corner = self.responses(pixels, centres - first, RADIUS)
        count = len(shape)
        highest = likely.reshape(count, -1).max(axis=1).astype(np.float64)
        np.square(likely, out=likely)
        place = ((corner + first) / self.scale).astype(np.float32)
        return ResponseMaps(np.arange(count), likely, place, np.full((count, 1), 1.0 / self.scale, np.float32)), highest

    def responses(
        self, pixels: NDArray[np.uint8], centres: IntArray, radius: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Responses (N, w, w) of w = 2 radius + 1 places round centres (N, 2) of a picture (H, W); rows are y.

        And the first place (N, 2) of each window: one that would leave the picture is moved inside.

        Notes
        -----
        A unit sees `relu(b + W . patch / d)` with the patch's deviation d: `relu(b d + W . patch) / d`, so that the
        biases are a row of the same product, and a place is divided once and not in every unit.
        """
        side = 2 * radius + 1
        height, width = pixels.shape
        limit = np.array([width, height]) - side - PATCH + 1
        corner = np.minimum(np.maximum(centres - (radius + HALF), 0), limit)
        crops = np.subtract(_crops(pixels, corner, side + PATCH - 1), _GREY, dtype=np.float32)
        deviation = _deviations(crops, side)
        units = np.matmul(_patches(crops, side, deviation), self._hidden_with_bias)
        np.maximum(units, 0.0, out=units)
        score = np.matmul(units, self.output[:, :, None])[..., 0]
        score /= deviation
        score += self.output_bias[:, None]
        np.negative(score, out=score)
        np.exp(score, out=score)
        score += 1.0
        return np.reciprocal(score, out=score).reshape(len(corner), side, side), corner + HALF

    @cached_property
    def _hidden_with_bias(self) -> NDArray[np.float32]:
        """(N, 122, U)."""
        return np.concatenate([self.hidden, self.hidden_bias[:, None]], axis=1)

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


def _crops(pixels: NDArray[np.uint8], corner: IntArray, side: int) -> NDArray[np.uint8]:
    """(N, side, side) squares that start at corner (N, 2)."""
    height, width = pixels.shape
    every = (height - side + 1, width - side + 1, side, side)
    squares: NDArray[np.uint8] = np.ndarray(every, np.uint8, pixels, 0, pixels.strides * 2)
    out: NDArray[np.uint8] = squares[corner[:, 1], corner[:, 0]]
    return out


def _deviations(crops: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """(N, side * side) standard deviation of every patch of the crops (N, S, S), noise added."""
    flat = crops.reshape(len(crops), -1)
    boxes = _boxes(crops.shape[1], side)
    mean = flat @ boxes
    out: NDArray[np.float32] = np.square(flat) @ boxes
    out -= np.square(mean, out=mean)
    np.maximum(out, 0.0, out=out)
    out += np.float32(CONTRAST_FLOOR**2)
    return np.sqrt(out, out=out)


@cache
def _boxes(span: int, side: int) -> NDArray[np.float32]:
    """(span * span, side * side): the mean of each patch of a crop as a matrix product."""
    first, step = np.arange(side), np.arange(span)[:, None]
    covers = ((step >= first) & (step < first + PATCH)).astype(np.float32) / PATCH
    return np.kron(covers, covers)


def _patches(crops: NDArray[np.float32], side: int, deviation: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, side * side, 122) every patch of the crops (N, S, S), row by row, and behind each its deviation.

    The columns are unfolded first: a patch is then a run of 121 numbers that starts 11 after the one above it, and
    the second copy moves long runs instead of single rows of a patch.
    """
    count, span, _ = crops.shape
    a, b, c = crops.strides
    columns: NDArray[np.float32] = np.ndarray((count, side, span, PATCH), np.float32, crops, 0, (a, c, b, c))
    unfolded = np.ascontiguousarray(columns)
    a, b, c, d = unfolded.strides
    out = np.empty((count, side, side, PATCH * PATCH + 1), np.float32)
    out[..., :-1] = np.ndarray((count, side, side, PATCH * PATCH), np.float32, unfolded, 0, (a, c, b, d))
    out[..., -1] = deviation.reshape(count, side, side)
    return out.reshape(count, side * side, -1)
