"""Convolutional experts: small networks that compute response maps of landmarks (method.md, section 3.3).

The patch experts of a constrained local model see 11 x 11 pixels and confuse a lid with a brow, or a lip with a tooth.
Convolutional experts (Zadeh, Baltrusaitis & Morency 2017) see more. Here all landmarks share layers, so that each sees
the whole face or the whole eye, at the cost of a few million multiplications.

`FaceExperts` see the whole face, coarsely; `PartExperts` see an eye with its brow, or the mouth with the base of the
nose, finely. While a face is being followed, the whole face is seen by the *glance*, at half the size and a quarter of
the cost. Maps are in the *face frame* of the given pose: the image translated by the pose, without its roll and divided
by its scale, so that lengths are outer-eye distances.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from math import inf

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import BROWS, MIRROR
from ..numeric.arrays import FloatArray, IntArray
from ..numeric.linalg import multiply
from .grey import Grey
from .network import Network
from .reference import translate_pose, warp_to_reference

FACE_STRIDE = 4
"""Pixels per cell of the maps of the whole face."""
PART_STRIDE = 2
"""Pixels per cell of the maps of the parts."""
_FACE_FLOOR = 8.0
"""Grey levels added to the standard deviation of the crop of a face, so that the noise of a flat one is not
amplified."""
_PART_FLOOR = 6.0
"""Grey levels added to that of the crop of a part, for the same reason."""
_NOTHING = np.float32(1e-20)
_ALL = np.arange(len(MIRROR))


@dataclass(frozen=True)
class ResponseMaps:
    """Likelihoods of the positions of some landmarks.

    Attributes
    ----------
    landmarks : (n,) int
        Indices of the landmarks, of the 66.
    likelihood : (n, h, w) float32
        Likelihoods, up to a factor per map.
    corner : (n, 2) float32
        Position `(x, y)` of the first cell of each map, in the frame of the fit.
    stride : (n, 1) float32
        Distance between neighbouring cells, in the same unit.
    """

    landmarks: IntArray
    likelihood: NDArray[np.float32]
    corner: NDArray[np.float32]
    stride: NDArray[np.float32]

    @cached_property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean position (n, 2) and total variance (n,) of each map."""
        count, height, width = self.likelihood.shape
        # Sums of 1, x, y and x^2 + y^2 by a single product; coordinates from the centre suit single precision.
        sums = multiply(self.likelihood.reshape(count, -1), _powers(width, height).T)
        sums *= 1.0 / sums[:, :1]
        mean = sums[:, 1:3]
        variance = sums[:, 3] - np.square(mean).sum(axis=1)
        place = self.corner + self.stride * (mean + _middle(width, height))
        return place.astype(np.float64), (self.stride[:, 0] ** 2 * variance).astype(np.float64)

    def replaced(self, other: ResponseMaps, chosen: NDArray[np.bool_]) -> ResponseMaps:
        """Return these maps with those that are `chosen` (n,) replaced by other ones of the same landmarks and size."""
        return ResponseMaps(
            self.landmarks,
            np.where(chosen[:, None, None], other.likelihood, self.likelihood),
            np.where(chosen[:, None], other.corner, self.corner),
            self.stride,
        )

    def shifts(self, places: FloatArray, variance: float) -> FloatArray:
        """Return the mean-shift vectors (n, 2) of landmarks at `places` (n, 2) in the frame of the maps (equation 3.3).

        `variance` is `rho`, that of the Gaussian about each landmark, in squared units of that frame; infinity gives
        the shift to the mean of the map. The Gaussian is separable, so the weights
        ``w_i(y) = pi_i(y) N(y; x_i, rho I)`` are never formed (Saragih et al. 2011, equation 20).
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
        # One-dimensional Gaussians with and without their offsets; the products with the map hold the sums of 1, x and
        # y.
        along = np.matmul(self.likelihood, pairs[:, 0, :, :width].transpose(0, 2, 1))
        sums = np.matmul(pairs[:, 1, :, :height], along)
        # Far outside its map a landmark sees only zeros, and does not move.
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
    """(4, height * width): 1, x, y and x^2 + y^2 of each cell, from the middle of the map."""
    x, y = np.tile(np.arange(width), height), np.repeat(np.arange(height), width)
    x, y = x - (width - 1) / 2.0, y - (height - 1) / 2.0
    powers: NDArray[np.float32] = np.stack([np.ones(len(x)), x, y, x * x + y * y]).astype(np.float32)
    return powers


def standardise(crop: NDArray[np.uint8], floor: float) -> NDArray[np.float32]:
    """Standardise a grey crop to mean 0 and about unit contrast; `floor` grey levels are added to its deviation."""
    mean, deviation = cv2.meanStdDev(crop)
    out: NDArray[np.float32] = np.subtract(crop, np.float32(mean[0, 0]), dtype=np.float32)
    out *= np.float32(1.0 / (deviation[0, 0] + floor))
    return out


def crop_face(grey: Grey, pose: FloatArray, scale: float, size: int) -> NDArray[np.float32]:
    """Crop the standardised input (size, size) of the experts of the whole face, as `warp_to_reference` does."""
    return standardise(warp_to_reference(grey, pose, scale, (size, size)).pixels, _FACE_FLOOR)


def crop_part(grey: Grey, pose: FloatArray, scale: float, size: tuple[int, int]) -> NDArray[np.float32]:
    """Crop the standardised input (height, width) of the experts of a part, centred on the translation of `pose`."""
    return standardise_part(warp_to_reference(grey, pose, scale, size).pixels)


def standardise_part(crop: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Standardise the crop of a part."""
    return standardise(crop, _PART_FLOOR)


def first_cell(size: int, stride: int) -> float:
    """Position in pixels, from the centre of a crop, of the first cell of `stride` pixels along a side of `size`."""
    return (stride - 1) / 2.0 - (size - 1) / 2.0


def _likelihood(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert scores (n, h, w), log-likelihoods up to a constant, to likelihoods of at most 1, in place."""
    flat = scores.reshape(len(scores), -1)
    flat -= flat.max(axis=1, keepdims=True)
    np.exp(flat, out=flat)
    return scores


@dataclass(frozen=True)
class FaceExperts:
    """Experts for all 66 landmarks, and for whether there is a face, that see the whole face.

    Attributes
    ----------
    network : Network
        From crops to maps and log odds.
    scale : float
        Pixels per outer-eye distance.
    size : int
        Side of the crop in pixels, a multiple of 16.
    """

    network: Network
    scale: float
    size: int

    def respond(self, grey: Grey, pose: FloatArray) -> tuple[ResponseMaps, float]:
        """Return the maps of all landmarks in the face frame of an approximate pose, and the log odds of a face."""
        return self.read(*self.network(self.crop(grey, pose)))

    def crop(self, grey: Grey, pose: FloatArray) -> NDArray[np.float32]:
        """Crop the input (1, size, size) of the network."""
        return crop_face(grey, pose, self.scale, self.size)[None]

    def read(self, maps: NDArray[np.float32], face: NDArray[np.float32]) -> tuple[ResponseMaps, float]:
        """Return what `respond` does, from the outputs of the network."""
        return ResponseMaps(_ALL, _likelihood(maps[0]), self._corner, self._stride), float(face.mean())

    @cached_property
    def _corner(self) -> NDArray[np.float32]:
        return np.full((len(_ALL), 2), first_cell(self.size, FACE_STRIDE) / self.scale, np.float32)

    @cached_property
    def _stride(self) -> NDArray[np.float32]:
        return np.full((len(_ALL), 1), FACE_STRIDE / self.scale, np.float32)


@dataclass(frozen=True)
class FacePart:
    """A part of the face, and the network that sees crops of it.

    Attributes
    ----------
    network : Network
        Network for one side; the other side is shown to it mirrored.
    landmarks : (n,) int
        Landmarks whose mean is the centre of the crop; those of the part on the viewer's left if there are two.
    scale : float
        Pixels per outer-eye distance.
    size : (int, int)
        Width and height of the crop in pixels.
    paired : bool
        Whether the other half of the face has the same part, mirrored.
    """

    network: Network
    landmarks: IntArray
    scale: float
    size: tuple[int, int]
    paired: bool

    @cached_property
    def sides(self) -> IntArray:
        """Landmarks of the part, and of its mirror image, (1 or 2, n)."""
        sides: IntArray = np.stack([self.landmarks, MIRROR[self.landmarks]][: 1 + self.paired])
        return sides

    @cached_property
    def _averages(self) -> FloatArray:
        """Weights whose product with the landmarks is the centre of each side, (1 or 2, 66)."""
        averages = np.zeros((len(self.sides), len(MIRROR)))
        np.put_along_axis(averages, self.sides, 1.0 / len(self.landmarks), axis=1)
        return averages

    def centres(self, landmarks: FloatArray) -> FloatArray:
        """Return the centre of the landmarks of each side, (1 or 2, 2), from all landmarks (66, 2)."""
        return np.asarray(self._averages @ landmarks)

    def crops(self, grey: Grey, poses: Iterable[FloatArray]) -> NDArray[np.float32]:
        """Crop the standardised input (1 or 2, height, width) for each side, given its pose (6,) as for `crop_part`."""
        crops = np.empty((len(self.sides), *self.size[::-1]), np.float32)
        for crop, pose in zip(crops, poses, strict=True):
            crop[...] = crop_part(grey, pose, self.scale, self.size)
        if self.paired:
            crops[1] = crops[1, :, ::-1]
        return crops


@dataclass(frozen=True)
class PartExperts(FacePart):
    """Experts for the landmarks of one part of the face.

    Sides of its crop are multiples of 8. They have to be those of the training, as they determine how the coarsest
    cells lie about the centre.
    """

    @cached_property
    def shares_of_brows(self) -> tuple[FloatArray, FloatArray] | None:
        """Weights (1 or 2, n) whose products with a value of each map are its mean over each side's brow, and over the
        rest of that side; None for a part without brows.
        """
        brows, sides = np.isin(self.sides, BROWS), len(self.sides)
        if not brows.any():
            return None
        of_side = np.eye(sides, dtype=bool).repeat(self.sides.shape[1], axis=1)
        of_brows, others = of_side & brows.ravel(), of_side & ~brows.ravel()
        return of_brows / of_brows.sum(axis=1, keepdims=True), others / others.sum(axis=1, keepdims=True)

    @cached_property
    def _first_cell(self) -> FloatArray:
        """Offset from the centre of a part to the first cell of its maps, (2,)."""
        return np.array([first_cell(side, PART_STRIDE) for side in self.size]) / self.scale

    @cached_property
    def _stride(self) -> NDArray[np.float32]:
        return np.full((self.sides.size, 1), PART_STRIDE / self.scale, np.float32)

    def respond(self, grey: Grey, pose: FloatArray, shape: FloatArray, *, higher: float = 0.0) -> ResponseMaps:
        """Return the maps of the landmarks of the part around their approximate positions in `shape` (66, 2).

        Maps and shape are in the face frame of `pose` (6,); the crop lies `higher` outer-eye distances above that
        shape.
        """
        centres = self.centres(shape) - (0.0, higher)
        (maps,) = self.network(self.crops_at(grey, pose, centres))
        return self.read(maps, centres)

    def crops_at(self, grey: Grey, pose: FloatArray, centres: FloatArray) -> NDArray[np.float32]:
        """Crop the input of the network at the `centres`, in the face frame of `pose` (6,)."""
        return self.crops(grey, (translate_pose(pose, *centre) for centre in centres.tolist()))

    def read(self, maps: NDArray[np.float32], centres: FloatArray) -> ResponseMaps:
        """Return what `respond` does, from the output of the network for crops at the `centres`."""
        if self.paired:
            maps[1] = maps[1, :, :, ::-1]
        corner = (centres + self._first_cell).astype(np.float32)
        return ResponseMaps(
            self.sides.ravel(),
            _likelihood(maps.reshape(-1, *maps.shape[2:])),
            corner.repeat(self.sides.shape[1], axis=0),
            self._stride,
        )
