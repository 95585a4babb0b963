"""Linear patch experts of a constrained local model, as Saragih, Lucey and Cohn (2011) use them (method.md, 3.12).

Facemime's own model has none; they come from a file that the user gives (`facetracker_file`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray, IntArray
from .experts import ResponseMaps
from .pdm import PointDistributionModel

GREY, GRADIENT, PATTERN = range(3)
"""What an expert sees: grey levels, squared gradients, or local binary patterns."""
REACH = 1.35
"""Half the side of the reference frame, in outer-eye distances; no face is larger."""
_STEEPEST = 50.0
"""Largest exponent of the logistic function; beyond it, single precision overflows."""


@dataclass(frozen=True)
class LinearExpert:
    """``1 / (1 + exp(gain r + offset))``, where `r` correlates a normalised patch with `weights` (h, w).

    `kind` is what it sees: `GREY`, `GRADIENT` or `PATTERN`. A `gain` below 0 makes similar patches likely.
    """

    kind: int
    gain: float
    offset: float
    weights: NDArray[np.float32]

    def respond(self, crop: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the likelihoods (H - h + 1, W - w + 1) of all patches of a crop (H, W)."""
        alike = np.nan_to_num(cv2.matchTemplate(crop, self.weights, cv2.TM_CCOEFF_NORMED))
        power = np.clip(self.gain * np.clip(alike, -1.0, 1.0) + self.offset, -_STEEPEST, _STEEPEST)
        return np.asarray(1.0 / (1.0 + np.exp(power)), np.float32)


@dataclass(frozen=True)
class LinearView:
    """The experts of one view; those of a landmark see patches of one size, and a hidden landmark has none."""

    experts: tuple[tuple[LinearExpert, ...], ...]

    @cached_property
    def visible(self) -> FloatArray:
        """1 for each landmark that has experts, otherwise 0, (66,)."""
        return np.array([float(bool(own)) for own in self.experts])

    @cached_property
    def half(self) -> int:
        """Half of the largest patch, in pixels."""
        return max((max(e.weights.shape) // 2 for own in self.experts for e in own), default=0)

    def respond(self, pixels: NDArray[np.float32], centres: IntArray, radius: int) -> ResponseMaps:
        """Return maps with a sum of 1 in windows of ``2 radius + 1`` pixels about `centres` (66, 2).

        A map is the product of its landmark's experts. A window that would leave the image is moved inside.
        """
        count, side, span = len(self.experts), 2 * radius + 1, 2 * (radius + self.half) + 1
        first = np.clip(centres - radius - self.half, 0, len(pixels) - span)
        seen = (pixels, _squared_gradient(pixels), _binary_pattern(pixels))
        maps = np.full((count, side, side), 1.0 / side**2, np.float32)
        for i, (x, y) in enumerate(first.tolist()):
            for expert in self.experts[i]:
                below, right = (self.half - length // 2 for length in expert.weights.shape)
                height, width = (side + length - 1 for length in expert.weights.shape)
                crop = seen[expert.kind][y + below : y + below + height, x + right : x + right + width]
                maps[i] *= expert.respond(np.ascontiguousarray(crop))
                maps[i] /= max(float(maps[i].sum()), 1e-20)
        corner = (first + self.half).astype(np.float32)
        return ResponseMaps(np.arange(count), maps, corner, np.ones((count, 1), np.float32))


@dataclass(frozen=True)
class LinearModel:
    """A shape model in Facemime's head frame, and its linear experts.

    Attributes
    ----------
    scale : float
        Pixels per outer-eye distance that the experts see.
    centres : (V, 2) float64
        Pitch and yaw at the middle of each view, in radians.
    views : tuple of LinearView
        V views.
    model_id : str
        First digits of the file's checksum.
    """

    pdm: PointDistributionModel
    scale: float
    centres: FloatArray
    views: tuple[LinearView, ...]
    model_id: str

    def view(self, pose: FloatArray) -> LinearView:
        """Return the view whose middle is nearest to the rotation of a pose (6,)."""
        away: Sequence[float] = np.square(self.centres - pose[1:3]).sum(axis=1).tolist()
        return self.views[away.index(min(away))]


def _squared_gradient(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    out = np.zeros_like(pixels)
    out[1:-1, 1:-1] = (pixels[1:-1, 2:] - pixels[1:-1, :-2]) ** 2 + (pixels[2:, 1:-1] - pixels[:-2, 1:-1]) ** 2
    return out


def _binary_pattern(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum of powers of two, from 2 upwards, over neighbours in reading order that are not brighter than the pixel."""
    out = np.zeros_like(pixels)
    height, width = pixels.shape
    around = [(dy, dx) for dy in (0, 1, 2) for dx in (0, 1, 2) if (dy, dx) != (1, 1)]
    for power, (dy, dx) in enumerate(around, start=1):
        neighbour = pixels[dy : height - 2 + dy, dx : width - 2 + dx]
        out[1:-1, 1:-1] += np.float32(2**power) * (pixels[1:-1, 1:-1] >= neighbour)
    return out
