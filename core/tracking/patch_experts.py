"""Experts that see small patches or measure actions: small networks besides those of `experts`.

They refine what the convolutional experts found: they see only a few pixels, and so follow the visible edge. A
hidden layer, rather than the linear filter of the original model, distinguishes a shut lid from a brow, at the cost
of a single matrix product for all landmarks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import N_LANDMARKS
from ..face.names import ACTION_MIRROR, N_ACTIONS
from ..numeric.arrays import FloatArray, IntArray
from ..numeric.opencv import Node, encode_network
from .experts import FacePart, ResponseMaps
from .grey import Grey
from .network import Network
from .reference import translate_pose, warp_to_reference

PATCH = 11


@dataclass(frozen=True)
class ActionExperts(FacePart):
    """Experts for the actions of one part of the face.

    Attributes
    ----------
    actions : (k,) int
        Indices into `actions.ACTIONS`; those of the performer's right side if the face has two such parts.
    """

    actions: IntArray

    @cached_property
    def measured(self) -> IntArray:
        """Indices of all actions that are measured, in the order of the network's output."""
        both = [self.actions, ACTION_MIRROR[self.actions]][: 1 + self.paired]
        return np.asarray(np.concatenate(both), dtype=np.intp)

    def crops_at(self, grey: Grey, pose: FloatArray, landmarks: FloatArray) -> NDArray[np.float32]:
        """Crop the input of the network (1 or 2, height, width) for landmarks (66, 2) in pixels."""
        poses = pose[None].repeat(len(self.sides), axis=0)
        poses[:, 4:6] = self.centres(landmarks)
        return self.crops(grey, poses)


def measure_actions(
    experts: Sequence[ActionExperts], crops: Sequence[NDArray[np.float32]], before: FloatArray | None = None
) -> FloatArray:
    """Estimate the activations (15,) of all actions from the crops of each expert: about 0 at rest, 1 at full strength.

    They may differ from 0 at rest, as people look different. Parts without any of the `experts` keep those of `before`
    (15,), an earlier frame; without it they are 0.
    """
    activations = np.zeros(N_ACTIONS) if before is None else before.copy()
    for part, crop in zip(experts, crops, strict=True):
        activations[part.measured] = part.network(crop)[0].ravel()
    return activations


HALF = PATCH // 2
RADIUS = 2
"""Radius of the search window, in pixels."""
REACH = 0.95
"""Distance from the translation of the pose, in outer-eye distances, within which landmarks are sought; no face is
larger."""
_Number = TypeVar("_Number", bound=np.generic)
_GREY = np.float32(128.0)
CONTRAST_FLOOR = 4.0
"""Grey levels added to the deviation of a patch, so that the noise of flat ones is not amplified."""


@dataclass(frozen=True)
class PatchExperts:
    """Patch experts of one view at one scale: ``sigmoid(c + v . relu(b + W . patch))`` (equation 3.6).

    Attributes
    ----------
    scale : float
        Pixels per outer-eye distance at which they were trained.
    hidden : (N, 121, U) float32
        `W`; each column sums to 0, so that the mean of a patch does not matter.
    hidden_bias : (N, U), output : (N, U), output_bias : (N,) float32
        `b`, `v` and `c`.
    landmarks : (N,) int
        Indices of their landmarks, of the 66; by default all.
    """

    scale: float
    hidden: NDArray[np.float32]
    hidden_bias: NDArray[np.float32]
    output: NDArray[np.float32]
    output_bias: NDArray[np.float32]
    landmarks: IntArray = field(default_factory=lambda: np.arange(N_LANDMARKS))

    def respond(self, grey: Grey, pose: FloatArray, shape: FloatArray) -> tuple[ResponseMaps, FloatArray]:
        """Return maps of the squared responses around their landmarks, and the highest response (N,) of each, 0 to 1.

        `shape` (66, 2) holds all landmarks; shape and maps are in the face frame of `pose` (6,). One batched product of
        (N, 25, 122) by (N, 122, U), about 5 million multiplications for N = 46 and U = 32, takes 0.2 ms.
        """
        shape = shape[self.landmarks]
        # Whole pixels from the translation of the pose: independent of the window's extent, which changes with a blink.
        centres = np.round(np.minimum(np.maximum(shape, -REACH), REACH) * self.scale).astype(np.intp)
        first = centres.min(axis=0) - (HALF + RADIUS)
        size = centres.max(axis=0) + (HALF + RADIUS + 1) - first
        middle = ((first + (size - 1) / 2.0) / self.scale).tolist()
        width, height = size.tolist()
        pixels = warp_to_reference(grey, translate_pose(pose, *middle), self.scale, (width, height)).pixels
        likely, corner = self.responses(pixels, centres - first, RADIUS)
        count = len(shape)
        highest = likely.reshape(count, -1).max(axis=1).astype(np.float64)
        # Squared maps are narrower, so that the mean-shift ends nearer to the maximum.
        np.square(likely, out=likely)
        place = ((corner + first) / self.scale).astype(np.float32)
        stride = np.full((count, 1), 1.0 / self.scale, np.float32)
        return ResponseMaps(self.landmarks, likely, place, stride), highest

    def responses(
        self, pixels: NDArray[np.uint8], centres: IntArray, radius: int
    ) -> tuple[NDArray[np.float32], IntArray]:
        """Return responses (N, w, w), rows y, in windows of ``w = 2 radius + 1`` pixels about `centres` (N, 2).

        A window that would leave the image is moved inside; the first position `(x, y)` of each, (N, 2), is returned,
        too.
        """
        side = 2 * radius + 1
        height, width = pixels.shape
        limit = np.array([width, height]) - side - PATCH + 1
        corner = np.minimum(np.maximum(centres - (radius + HALF), 0), limit)
        crops = np.subtract(_crops(pixels, corner, side + PATCH - 1), _GREY, dtype=np.float32)
        # With the deviation d of a patch, relu(b + W . patch / d) is relu(b d + W . patch) / d: biases become a row of
        # the product, and positions are divided instead of hidden units.
        deviation = _crops(_deviations(pixels), corner, side).reshape(len(corner), -1)
        (units,) = self._hidden_layers(_patches(crops, side, deviation))
        score = np.einsum("nru,nu->nr", units[:, 0], self.output)
        score /= deviation
        score += self.output_bias[:, None]
        # The sigmoid, in place.
        np.negative(score, out=score)
        np.exp(score, out=score)
        score += 1.0
        return np.reciprocal(score, out=score).reshape(len(corner), side, side), corner + HALF

    @cached_property
    def _hidden_layers(self) -> Network:
        """Network of the hidden layers, from patches (N, 1, R, 122) to units (N, 1, R, U).

        scipy's BLAS, a product per patch, takes 0.6 to 0.7 times as long on a CPU with AVX-512, but 1.0 to 1.2 times on
        one with AVX2 only, with either kind of numpy.
        """
        matrices = np.concatenate([self.hidden, self.hidden_bias[:, None]], axis=1)[:, None]
        nodes = [Node("MatMul", ("patches", "matrices"), "sums"), Node("Relu", ("sums",), "units")]
        shape = (len(matrices), 1, 1, matrices.shape[2])
        return Network(encode_network(nodes, {"patches": shape}, {"matrices": matrices}), "units")

    def of(self, landmarks: IntArray) -> PatchExperts:
        """Return the experts of some of the landmarks; these experts must be of all 66."""
        return PatchExperts(
            self.scale,
            self.hidden[landmarks],
            self.hidden_bias[landmarks],
            self.output[landmarks],
            self.output_bias[landmarks],
            landmarks,
        )

    def mirrored(self, order: IntArray) -> PatchExperts:
        """Return the experts, of all 66 landmarks, of the mirrored view; `order` (66,) holds their counterparts."""
        units = self.hidden.shape[2]
        flipped = self.hidden.reshape(-1, PATCH, PATCH, units)[order, :, ::-1].reshape(self.hidden.shape)
        return PatchExperts(
            self.scale,
            np.ascontiguousarray(flipped),
            self.hidden_bias[order],
            self.output[order],
            self.output_bias[order],
        )


def _crops(pixels: NDArray[_Number], corner: IntArray, side: int) -> NDArray[_Number]:
    """Crop squares of an image whose first pixels are `corner` (N, 2), (N, side, side)."""
    height, width = pixels.shape
    every = (height - side + 1, width - side + 1, side, side)
    squares: NDArray[_Number] = np.ndarray(every, pixels.dtype, pixels, 0, pixels.strides * 2)
    out: NDArray[_Number] = squares[corner[:, 1], corner[:, 0]]
    return out


def _deviations(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Standard deviation of each patch of an image, with the floor added, at the patch's first pixel."""
    inside = slice(HALF, -HALF)
    mean, square = (
        np.asarray(box(pixels, cv2.CV_32F, (PATCH, PATCH)), np.float32)[inside, inside]
        for box in (cv2.boxFilter, cv2.sqrBoxFilter)
    )
    variance = np.maximum(square - mean * mean, 0.0) + CONTRAST_FLOOR**2
    return np.asarray(np.sqrt(variance), dtype=np.float32)


def _patches(crops: NDArray[np.float32], side: int, deviation: NDArray[np.float32]) -> NDArray[np.float32]:
    """All patches of the crops (N, S, S), row by row, each followed by its deviation, (N, side * side, 122).

    Columns are unfolded first. A patch is then a run of 121 numbers that starts 11 after the one above it, so the
    second copy moves long runs rather than single rows of a patch.
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
