"""Small networks that OpenCV runs on the CPU, such as one that detects faces of any size and from any side in one pass
(method.md, section 3.2), and the learnt decision whether there is a face where a fit ended (section 3.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message
from ..numeric.arrays import FloatArray
from ..numeric.opencv import network_error, read_network

STRIDE = 8
"""Pixels between neighbouring cells of the network."""
UNIT = 16.0
"""Unit of the network's outputs in pixels."""
SMALLEST = 9.0
"""Smallest outer-eye distance, in pixels, of faces that the network finds."""
LARGEST = 30.0
"""Largest outer-eye distance, in pixels, of faces that the network finds."""
OUTPUTS = ("x", "y", "size", "cos roll", "sin roll", "sin yaw", "sin pitch")
"""Outputs per face beside the log odds. Position and size are in units, the size as a logarithm."""
SIDES = (64, 160, 400, 1000)
"""Pixels to which the longer side of an image is reduced, one after the other, for smaller and smaller faces."""
_ROUND = 16
_RIM = 16
"""Pixels by which the border of an image is extended, as faces may be cut by it."""
_ODDS = -1.5
"""Log odds above which a cell counts as a detection; the fit rejects false ones."""
_APART = 0.5
"""Distance, in outer-eye distances, within which two detections are of the same face."""
N_FEATURES = 6

Outputs: TypeAlias = tuple[NDArray[np.float32], ...]
"""Outputs of a network, in the order of their names."""


class Network:
    """A network with one input `(B, 1, H, W)` and named outputs; raises ModelError as `read_network` does.

    Do not share an instance between threads, as OpenCV keeps the buffers of a call in it.
    """

    def __init__(self, onnx: bytes, *outputs: str) -> None:
        self.onnx = onnx
        self._outputs = list(outputs)
        self._net = read_network(onnx)

    def __reduce__(self) -> tuple[type[Network], tuple[bytes | str, ...]]:
        """Return what a copy, or one in another process, is made from."""
        return Network, (self.onnx, *self._outputs)

    def __call__(self, images: NDArray[np.float32]) -> Outputs:
        """Return the outputs for standardised images (B, H, W), in the order of their names."""
        try:
            self._net.setInput(images[:, None])
            return tuple(np.asarray(out, np.float32) for out in self._net.forward(self._outputs))
        except cv2.error as error:
            raise network_error(Message("run")) from error

    def check(self, size: tuple[int, int], *shapes: tuple[int, ...]) -> None:
        """Check the outputs for an image of `size` (width, height).

        Raises ValueError if one of them has another shape or is not finite.
        """
        outputs = self(np.zeros((1, *size[::-1]), np.float32))
        for name, output, shape in zip(self._outputs, outputs, shapes, strict=True):
            if output.shape != shape or not np.isfinite(output).all():
                raise DataError(
                    "output {name} of a network has the shape {shape}, not {expected}, or is not finite",
                    name=name,
                    shape=output.shape,
                    expected=shape,
                )


_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""A quarter turn, clockwise because y points down."""


@dataclass(frozen=True)
class Detection:
    """A possible face.

    Attributes
    ----------
    pose : (6,) float64
        Pose in the image frame.
    odds : float
        Log odds that it is a face.
    """

    pose: FloatArray
    odds: float


class NetworkDetector:
    """Detects faces by a network from standardised images to `OUTPUTS`; `CascadeDetector` is the alternative."""

    def __init__(self, network: Network) -> None:
        self.network = network

    def detect(self, grey: NDArray[np.uint8], sides: tuple[int, ...] = SIDES[:3], turns: int = 0) -> list[Detection]:
        """Detect faces tilted by up to about 60 degrees in a grey image (H, W), once each, the likeliest first.

        The image is reduced to each of `sides`, from `SIDES`. `turns` are clockwise quarter turns by which the faces
        are additionally tilted. It takes about 1 ms at a side of 160 pixels and 4 ms at 400.
        """
        upright = np.ascontiguousarray(np.rot90(grey, turns))
        wanted = [side for i, side in enumerate(sides) if i == 0 or max(grey.shape) > sides[i - 1]]
        found = [_turned(face, turns, upright, grey) for side in wanted for face in self._at(upright, side)]
        found.sort(key=lambda f: -f.odds)
        kept: list[Detection] = []
        for face in found:
            if all(np.hypot(*(face.pose[4:6] - k.pose[4:6])) > _APART * max(face.pose[0], k.pose[0]) for k in kept):
                kept.append(face)
        return kept

    def _at(self, grey: NDArray[np.uint8], side: int) -> list[Detection]:
        factor = max(max(grey.shape) / side, 1.0)
        size = (max(round(grey.shape[1] / factor), 1), max(round(grey.shape[0] / factor), 1))
        small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if factor > 1.0 else grey
        right, below = (-(length + 2 * _RIM) % _ROUND + _RIM for length in size)
        padded = cv2.copyMakeBorder(small, _RIM, below, _RIM, right, cv2.BORDER_REPLICATE)
        (out,) = self.network(((padded.astype(np.float32) - 128.0) / 64.0)[None])
        odds = out[0, 0]
        # A face is where the odds are highest among the neighbouring cells.
        peaks = (odds >= cv2.dilate(odds, np.ones((3, 3), np.uint8))) & (odds > _ODDS)
        scale = np.array(grey.shape[::-1]) / size
        faces = []
        for row, column in np.argwhere(peaks):
            x, y, length, c, s, yaw, pitch = (float(v) for v in out[0, 1:, row, column])
            place = (np.array([column, row]) + 0.5) * STRIDE - _RIM + UNIT * np.array([x, y])  # pixels' edges
            turned = np.arcsin(np.clip([pitch, yaw], -1.0, 1.0))
            pose = np.array([UNIT * np.exp(length) * factor, *turned, np.arctan2(s, c), *(place * scale - 0.5)])
            faces.append(Detection(pose, float(odds[row, column])))
        return faces


def _turned(face: Detection, turns: int, upright: NDArray[np.uint8], grey: NDArray[np.uint8]) -> Detection:
    """Convert a detection in `upright` to the image `grey`, which is turned clockwise by quarter turns."""
    middle, origin = ((np.array(image.shape[::-1]) - 1) / 2.0 for image in (upright, grey))
    pose = face.pose.copy()
    pose[3] = (pose[3] + turns * np.pi / 2.0 + np.pi) % (2.0 * np.pi) - np.pi
    pose[4:6] = np.linalg.matrix_power(_QUARTER, turns) @ (pose[4:6] - middle) + origin
    return Detection(pose, face.odds)


@dataclass(frozen=True)
class FaceCheck:
    """Logistic regression over a few features of a fit.

    Attributes
    ----------
    weights : (6,) float64
        Weights of the features: 1; the log odds of the face network; and, for the maps of the face and those of the
        parts, the mean certainty and the mean distance between a map's mean and the fitted landmark.
    """

    weights: FloatArray

    def confidence(self, features: FloatArray) -> float:
        """Return the confidence, 0 to 1, for features (6,); 0.5 means that face and no face are equally likely."""
        return 1.0 / (1.0 + exp(-float(np.clip(features @ self.weights, -30.0, 30.0))))
