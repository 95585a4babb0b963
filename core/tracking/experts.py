"""Convolutional experts: small networks that say of every place how likely each landmark is there.

The patch experts of a constrained local model see 11 x 11 pixels and confuse a lid with a brow, or a lip with a tooth
(convolutional experts: Zadeh, Baltrusaitis & Morency 2017). Here all landmarks share the layers that look at the
picture, so that each sees the whole face, or the whole eye, at the cost of a few million multiplications.

Two kinds look at a frame: `FaceExperts` at the whole face, coarsely, and `PartExperts` at an eye with its brow or at
the mouth with the nose's base, finely. Both answer in the *face frame* of the pose that they were shown: the image
moved to the pose's translation, turned back by its roll and divided by its scale, so that lengths are outer-eye
distances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..landmarks import MIRROR
from .network import Network
from .reference import warp_to_reference

FACE_SCALE, FACE_SIZE, FACE_STRIDE = 36.0, 96, 4
"""Pixels an outer-eye distance, side of the picture, and pixels a cell of the maps, of the face experts."""
PART_STRIDE = 2
_FACE_FLOOR, _PART_FLOOR = 8.0, 6.0
"""Grey levels added to a picture's standard deviation: flat pictures are noise, and stay small."""


@dataclass(frozen=True)
class ResponseMaps:
    """Where some landmarks are likely to be.

    Attributes
    ----------
    landmarks : (n,) int
        Which of the 66.
    probability : (n, w, w) float32
        Each map sums to 1; rows are y.
    corner : (n, 2) float32
        Place `(x, y)` of each map's first cell, in the frame of the fit.
    stride : (n, 1) float32
        Distance of neighbouring cells.
    """

    landmarks: IntArray
    probability: NDArray[np.float32]
    corner: NDArray[np.float32]
    stride: NDArray[np.float32]

    def moved(self, by: FloatArray) -> ResponseMaps:
        """The same maps, each landmark's moved by its row of `by` (66, 2)."""
        return replace(self, corner=self.corner + by[self.landmarks].astype(np.float32))

    @cached_property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean place (n, 2) and total variance (n,) of each map."""
        steps = np.arange(self.probability.shape[1], dtype=np.float32)
        powers = np.array([steps, steps * steps]).T
        along = np.einsum("nyx->nx", self.probability) @ powers
        down = (self.probability @ np.ones_like(steps)) @ powers
        mean = np.array([along[:, 0], down[:, 0]]).T
        variance = along[:, 1] + down[:, 1] - (mean * mean).sum(1)
        place = self.corner + self.stride * mean
        return place.astype(np.float64), (self.stride[:, 0] ** 2 * variance).astype(np.float64)

    def shifts(self, places: FloatArray, variance: float) -> FloatArray:
        """(n, 2) `v`: from places (n, 2) to the map's mean under a Gaussian of `variance` round each (eq. 20).

        Infinite variance gives the way to the map's own mean. The Gaussian is separable, so the weights
        `w_i(y) = pi_i(y) N(x_i; y, rho I)` are never formed.
        """
        if variance == inf:
            return self.moments[0] - places
        count, side = self.probability.shape[:2]
        away = (self.corner - places.astype(np.float32))[:, :, None] + self.stride[:, :, None] * np.arange(side)
        to = away.astype(np.float32)
        near = np.exp(to * to * np.float32(-0.5 / variance))
        pairs = np.empty((count, 2, side, 2), np.float32)
        pairs[..., 0] = near
        pairs[..., 1] = near * to
        along = np.matmul(self.probability, pairs[:, 0])
        sums = np.matmul(pairs[:, 1].transpose(0, 2, 1), along)
        # A landmark far outside its map sees only zeros and is drawn nowhere.
        total = np.maximum(sums[:, 0, 0], 1e-20)
        out = np.empty((count, 2))
        np.divide(sums[:, 0, 1], total, out=out[:, 0])
        np.divide(sums[:, 1, 0], total, out=out[:, 1])
        return out


def standardised(picture: NDArray[np.float32], floor: float) -> NDArray[np.float32]:
    """A picture (S, S) of mean 0 and about unit contrast."""
    mean, deviation = cv2.meanStdDev(picture)
    out: NDArray[np.float32] = picture - np.float32(mean[0, 0])
    out *= np.float32(1.0 / (deviation[0, 0] + floor))
    return out


def face_picture(grey: NDArray[np.uint8], pose: FloatArray) -> NDArray[np.float32]:
    """(96, 96) what the face experts see of a grey image (H, W) at a pose (6,)."""
    return standardised(warp_to_reference(grey, pose, FACE_SCALE, FACE_SIZE).pixels, _FACE_FLOOR)


def part_picture(grey: NDArray[np.uint8], pose: FloatArray, scale: float, size: int) -> NDArray[np.float32]:
    """(size, size) what a part's experts see; the pose's translation is the part's centre."""
    return standardised(warp_to_reference(grey, pose, scale, size).pixels, _PART_FLOOR)


def first_cell(size: int, stride: int) -> float:
    """Pixels from a picture's centre to the centre of its maps' first cell, x and y alike."""
    return (stride - 1) / 2.0 - (size - 1) / 2.0


def _softmax(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scores (..., w, w) as probabilities that sum to 1 over the last two axes; the input is overwritten."""
    scores -= scores.max(axis=(-2, -1), keepdims=True)
    np.exp(scores, out=scores)
    scores /= scores.sum(axis=(-2, -1), keepdims=True)
    return scores


class FaceExperts:
    """All 66 landmarks in the whole face, and whether it is one."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self._landmarks = np.arange(len(MIRROR))

    def look(self, grey: NDArray[np.uint8], pose: FloatArray) -> tuple[ResponseMaps, float]:
        """Maps in the face frame of `pose` (6,), and the log odds that a face is there at about that pose.

        About 1 ms.
        """
        maps, face = self.network(face_picture(grey, pose)[None])
        corner = np.full((len(self._landmarks), 2), first_cell(FACE_SIZE, FACE_STRIDE) / FACE_SCALE, np.float32)
        stride = np.full((len(self._landmarks), 1), FACE_STRIDE / FACE_SCALE, np.float32)
        return ResponseMaps(self._landmarks, _softmax(maps[0]), corner, stride), float(face.mean())


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
    size : int
        Side of the picture in pixels, a multiple of 8.
    paired : bool
        Whether the other half of the face has the same part, seen in a mirror.
    """

    network: Network
    landmarks: IntArray
    scale: float
    size: int
    paired: bool

    def look(self, grey: NDArray[np.uint8], pose: FloatArray, shape: FloatArray) -> ResponseMaps:
        """Maps in the face frame of `pose` (6,), looked for round landmarks `shape` (66, 2) of that frame."""
        sides = [self.landmarks, MIRROR[self.landmarks]] if self.paired else [self.landmarks]
        centres = [shape[side].sum(0) / len(side) for side in sides]
        pictures = np.empty((len(sides), self.size, self.size), np.float32)
        for picture, centre in zip(pictures, centres, strict=True):
            picture[...] = part_picture(grey, _moved(pose, centre), self.scale, self.size)
        if self.paired:
            pictures[1] = pictures[1, :, ::-1]
        maps = _softmax(self.network(pictures)[0])
        if self.paired:
            maps[1] = maps[1, :, :, ::-1]
        reach = first_cell(self.size, PART_STRIDE) / self.scale
        stride = PART_STRIDE / self.scale
        return ResponseMaps(
            np.concatenate(sides),
            maps.reshape(-1, *maps.shape[2:]),
            np.repeat(np.array(centres, np.float32) + np.float32(reach), len(self.landmarks), axis=0),
            np.full((len(sides) * len(self.landmarks), 1), stride, np.float32),
        )


def _moved(pose: FloatArray, by: FloatArray) -> FloatArray:
    """`pose` (6,) with its translation moved by `by` (2,) of its face frame."""
    c, s = pose[0] * np.cos(pose[3]), pose[0] * np.sin(pose[3])
    out = pose.copy()
    out[4:6] += (c * by[0] - s * by[1], s * by[0] + c * by[1])
    return out
