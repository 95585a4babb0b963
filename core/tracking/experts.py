"""Convolutional experts: small networks that say of every place how likely each landmark is there.

The patch experts of a constrained local model see 11 x 11 pixels and confuse a lid with a brow, or a lip with a tooth
(convolutional experts: Zadeh, Baltrusaitis & Morency 2017). Here all landmarks share the layers that look at the
picture, so that each sees the whole face, or the whole eye, at the cost of a few million multiplications.

Two kinds look at a frame: `FaceExperts` at the whole face, coarsely, and `PartExperts` at an eye with its brow or at
the mouth with the nose's base, finely. A face that is only followed is glanced at by experts that see it at half the
size, at a quarter of the cost. All answer in the *face frame* of the pose that they were shown: the image
moved to the pose's translation, turned back by its roll and divided by its scale, so that lengths are outer-eye
distances.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from math import inf

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..landmarks import MIRROR
from .network import Network
from .reference import moved, warp_to_reference

FACE_STRIDE, PART_STRIDE = 4, 2
"""Pixels a cell of the maps."""
_FACE_FLOOR, _PART_FLOOR = 8.0, 6.0
"""Grey levels added to a picture's standard deviation: flat pictures are noise, and stay small."""
_NOTHING = np.float32(1e-20)
_ALL = np.arange(len(MIRROR))


@dataclass(frozen=True)
class ResponseMaps:
    """Where some landmarks are likely to be.

    Attributes
    ----------
    landmarks : (n,) int
        Which of the 66.
    likelihood : (n, h, w) float32
        Up to a factor of each map's own.
    corner : (n, 2) float32
        Place `(x, y)` of each map's first cell, in the frame of the fit.
    stride : (n, 1) float32
        Distance of neighbouring cells.
    """

    landmarks: IntArray
    likelihood: NDArray[np.float32]
    corner: NDArray[np.float32]
    stride: NDArray[np.float32]

    @cached_property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean place (n, 2) and total variance (n,) of each map."""
        count, height, width = self.likelihood.shape
        sums = self.likelihood.reshape(count, -1) @ _powers(width, height)
        sums *= 1.0 / sums[:, :1]
        mean = sums[:, 1:3]
        variance = sums[:, 3] - np.square(mean).sum(axis=1)
        place = self.corner + self.stride * (mean + _middle(width, height))
        return place.astype(np.float64), (self.stride[:, 0] ** 2 * variance).astype(np.float64)

    def shifts(self, places: FloatArray, variance: float) -> FloatArray:
        """(n, 2) `v`: from places (n, 2) to the map's mean under a Gaussian of `variance` round each (eq. 20).

        Infinite variance gives the way to the map's own mean. The Gaussian is separable, so the weights
        `w_i(y) = pi_i(y) N(x_i; y, rho I)` are never formed.
        """
        if variance == inf:
            return self.moments[0] - places
        count, height, width = self.likelihood.shape
        longest = max(height, width)
        to = (self.corner - places.astype(np.float32))[:, :, None] + self.stride[:, :, None] * _cells(longest)
        pairs = np.empty((count, 2, 2, longest), np.float32)
        near, drawn = pairs[:, :, 0], pairs[:, :, 1]
        np.exp(to * to * np.float32(-0.5 / variance), out=near)
        np.multiply(near, to, out=drawn)
        # Rows (1, y) of the map and columns (1, x): their product holds the sums of 1, of x and of y.
        along = np.matmul(self.likelihood, pairs[:, 0, :, :width].transpose(0, 2, 1))
        sums = np.matmul(pairs[:, 1, :, :height], along)
        # A landmark far outside its map sees only zeros and is drawn nowhere.
        total = np.maximum(sums[:, :1, 0], _NOTHING)
        out: FloatArray = np.divide(sums.reshape(count, 4)[:, 1:3], total, dtype=np.float64)
        return out


@cache
def _cells(side: int) -> NDArray[np.float32]:
    return np.arange(side, dtype=np.float32)


@cache
def _middle(width: int, height: int) -> NDArray[np.float32]:
    return np.array([(width - 1) / 2.0, (height - 1) / 2.0], np.float32)


@cache
def _powers(width: int, height: int) -> NDArray[np.float32]:
    """(height * width, 4) of each cell 1, x, y and x^2 + y^2, from the middle of the map."""
    x, y = np.tile(np.arange(width), height), np.repeat(np.arange(height), width)
    x, y = x - (width - 1) / 2.0, y - (height - 1) / 2.0
    powers: NDArray[np.float32] = np.stack([np.ones(len(x)), x, y, x * x + y * y], axis=1).astype(np.float32)
    return powers


def standardised(picture: NDArray[np.uint8], floor: float) -> NDArray[np.float32]:
    """A picture (S, S) of mean 0 and about unit contrast."""
    mean, deviation = cv2.meanStdDev(picture)
    out: NDArray[np.float32] = np.subtract(picture, np.float32(mean[0, 0]), dtype=np.float32)
    out *= np.float32(1.0 / (deviation[0, 0] + floor))
    return out


def face_picture(grey: NDArray[np.uint8], pose: FloatArray, scale: float, size: int) -> NDArray[np.float32]:
    """(size, size) what face experts see of a grey image (H, W) at a pose (6,)."""
    return standardised(warp_to_reference(grey, pose, scale, (size, size)).pixels, _FACE_FLOOR)


def part_picture(grey: NDArray[np.uint8], pose: FloatArray, scale: float, size: tuple[int, int]) -> NDArray[np.float32]:
    """(height, width) what a part's experts see; the pose's translation is the part's centre."""
    return standardised(warp_to_reference(grey, pose, scale, size).pixels, _PART_FLOOR)


def first_cell(size: int, stride: int) -> float:
    """Pixels from a picture's centre to the centre of its maps' first cell, along a side of `size` pixels."""
    return (stride - 1) / 2.0 - (size - 1) / 2.0


def _likelihood(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scores (n, h, w), logarithms up to a constant, as likelihoods of at most 1; the input is overwritten."""
    flat = scores.reshape(len(scores), -1)
    flat -= flat.max(axis=1, keepdims=True)
    np.exp(flat, out=flat)
    return scores


@dataclass(frozen=True)
class FaceExperts:
    """All 66 landmarks in the whole face, and whether it is one.

    Attributes
    ----------
    network : Network
    scale : float
        Pixels an outer-eye distance.
    size : int
        Side of the picture in pixels, a multiple of 16.
    """

    network: Network
    scale: float
    size: int

    def look(self, grey: NDArray[np.uint8], pose: FloatArray) -> tuple[ResponseMaps, float]:
        """Maps in the face frame of `pose` (6,), and the log odds that a face is there at about that pose."""
        maps, face = self.network(face_picture(grey, pose, self.scale, self.size)[None])
        return ResponseMaps(_ALL, _likelihood(maps[0]), self._corner, self._stride), float(face.mean())

    @cached_property
    def _corner(self) -> NDArray[np.float32]:
        return np.full((len(_ALL), 2), first_cell(self.size, FACE_STRIDE) / self.scale, np.float32)

    @cached_property
    def _stride(self) -> NDArray[np.float32]:
        return np.full((len(_ALL), 1), FACE_STRIDE / self.scale, np.float32)


@dataclass(frozen=True)
class PartExperts:
    """The landmarks of one part of the face.

    Attributes
    ----------
    network : Network
    landmarks : (n,) int
        Of the part; of the viewer's left one where there are two.
    scale : float
        Pixels an outer-eye distance.
    size : (int, int)
        Width and height of the picture in pixels, multiples of 8; those with which the network was taught, since its
        coarsest cells lie otherwise about the centre of another size.
    paired : bool
        Whether the other half of the face has the same part, seen in a mirror.
    """

    network: Network
    landmarks: IntArray
    scale: float
    size: tuple[int, int]
    paired: bool

    @cached_property
    def _sides(self) -> IntArray:
        """(1 or 2, n) landmarks of the part, and of the one in the mirror."""
        sides: IntArray = np.stack([self.landmarks, MIRROR[self.landmarks]][: 1 + self.paired])
        return sides

    @cached_property
    def _averages(self) -> FloatArray:
        """(1 or 2, 66) that give the middle of each side's landmarks."""
        averages = np.zeros((len(self._sides), len(MIRROR)))
        np.put_along_axis(averages, self._sides, 1.0 / len(self.landmarks), axis=1)
        return averages

    @cached_property
    def _first_cell(self) -> FloatArray:
        """(2,) from a part's centre to the first cell of its maps."""
        return np.array([first_cell(side, PART_STRIDE) for side in self.size]) / self.scale

    @cached_property
    def _stride(self) -> NDArray[np.float32]:
        return np.full((self._sides.size, 1), PART_STRIDE / self.scale, np.float32)

    def look(self, grey: NDArray[np.uint8], pose: FloatArray, shape: FloatArray) -> ResponseMaps:
        """Maps in the face frame of `pose` (6,), looked for round landmarks `shape` (66, 2) of that frame."""
        sides = self._sides
        centres = self._averages @ shape
        pictures = np.empty((len(sides), *self.size[::-1]), np.float32)
        for picture, centre in zip(pictures, centres.tolist(), strict=True):
            picture[...] = part_picture(grey, moved(pose, *centre), self.scale, self.size)
        if self.paired:
            pictures[1] = pictures[1, :, ::-1]
        (maps,) = self.network(pictures)
        if self.paired:
            maps[1] = maps[1, :, :, ::-1]
        corner = (centres + self._first_cell).astype(np.float32)
        return ResponseMaps(
            sides.ravel(),
            _likelihood(maps.reshape(-1, *maps.shape[2:])),
            corner.repeat(sides.shape[1], axis=0),
            self._stride,
        )
