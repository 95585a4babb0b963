"""A small network that detects faces of any size, from any side, in one pass (docs/method.md, section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .network import Network

STRIDE = 8
"""Pixels between the cells of the network."""
UNIT = 16.0
"""Pixels in which the network measures."""
SMALLEST, LARGEST = 9.0, 30.0
"""Outer-eye distances in pixels of the faces that it finds."""
OUTPUTS = ("x", "y", "size", "cos roll", "sin roll", "sin yaw", "sin pitch")
"""What it says of a face, beside the log odds: place and size in units, size as a logarithm."""
SIDES = (64, 160, 400, 1000)
"""Pixels to which the longer side of an image is reduced, one after the other, for smaller and smaller faces."""
_ROUND = 16
_RIM = 16
"""Pixels by which the border of an image is extended: faces may be cut by it."""
_ODDS = -1.5
"""Log odds above which a cell counts as a detection; the fit rejects false ones."""
_APART = 0.5
"""Outer-eye distances within which two detections are of one face."""
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""A quarter turn, clockwise, as y points down."""


@dataclass(frozen=True)
class Detection:
    """A possible face: its pose (6,), image frame, and the log odds."""

    pose: FloatArray
    odds: float


class NetworkDetector:
    """Detects faces by a network; see `CascadeDetector` for Viola and Jones' way.

    Parameters
    ----------
    network : Network
        From standardised pictures to `OUTPUTS`.
    """

    def __init__(self, network: Network) -> None:
        self.network = network

    def detect(self, grey: NDArray[np.uint8], sides: tuple[int, ...] = SIDES[:3], turns: int = 0) -> list[Detection]:
        """Detect the faces of an image, tilted by up to about 60 degrees.

        Parameters
        ----------
        grey : (H, W) uint8
            Grey image.
        sides : tuple of int
            Some of `SIDES`.
        turns : int
            Quarter turns, clockwise, by which the faces are tilted besides.

        Returns
        -------
        list of Detection
            The likeliest first, one per face.

        Notes
        -----
        About 1 ms at a side of 160 pixels and 4 ms at 400.
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
        # A face is where the odds are highest among the neighbours.
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
    """A detection in `upright`, in the image `grey`, which is turned clockwise by quarter turns."""
    middle, origin = ((np.array(image.shape[::-1]) - 1) / 2.0 for image in (upright, grey))
    pose = face.pose.copy()
    pose[3] = (pose[3] + turns * np.pi / 2.0 + np.pi) % (2.0 * np.pi) - np.pi
    pose[4:6] = np.linalg.matrix_power(_QUARTER, turns) @ (pose[4:6] - middle) + origin
    return Detection(pose, face.odds)
