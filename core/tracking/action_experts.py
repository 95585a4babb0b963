"""Experts of actions: small networks that read what no landmark shows (docs/method.md, section 3.11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..actions import ACTION_MIRROR, N_ACTIONS
from ..arrays import FloatArray, IntArray
from ..landmarks import MIRROR
from .experts import part_picture
from .network import Network


@dataclass(frozen=True)
class ActionExperts:
    """Experts for the actions of one part of the face.

    Attributes
    ----------
    network : Network
    actions : (n,) int
        Indices in `actions.ACTIONS`; those of the performer's right side if there are two such parts.
    landmarks : (m,) int
        Landmarks whose mean is the centre of the picture, on the same side.
    scale : float
        Pixels per outer-eye distance.
    size : (int, int)
        Width and height of the picture in pixels.
    paired : bool
        Whether the other half of the face has the same part, mirrored.
    """

    network: Network
    actions: IntArray
    landmarks: IntArray
    scale: float
    size: tuple[int, int]
    paired: bool

    @cached_property
    def _sides(self) -> IntArray:
        """(1 or 2, m) landmarks at the centre of the part, and of its mirror image."""
        sides: IntArray = np.stack([self.landmarks, MIRROR[self.landmarks]][: 1 + self.paired])
        return sides

    @cached_property
    def measured(self) -> IntArray:
        """Indices of all actions that are measured, in the order of `respond`."""
        both = [self.actions, ACTION_MIRROR[self.actions]][: 1 + self.paired]
        return np.asarray(np.concatenate(both), dtype=np.intp)

    def respond(self, grey: NDArray[np.uint8], pose: FloatArray, landmarks: FloatArray) -> FloatArray:
        """Estimate the activations.

        Parameters
        ----------
        grey : (H, W) uint8
            Grey image.
        pose : (6,) float64
            Pose of the face, image frame.
        landmarks : (66, 2) float64
            Image frame, pixels.

        Returns
        -------
        (n,) or (2 n,) float64
            Activations of `measured`.
        """
        pictures = np.empty((len(self._sides), *self.size[::-1]), np.float32)
        place = pose.copy()
        for picture, side in zip(pictures, self._sides, strict=True):
            place[4:6] = landmarks[side].mean(axis=0)
            picture[...] = part_picture(grey, place, self.scale, self.size)
        # The network knows one side only; the other is shown mirrored.
        if self.paired:
            pictures[1] = pictures[1, :, ::-1].copy()
        (activations,) = self.network(pictures)
        return np.asarray(activations.ravel(), dtype=np.float64)


def measure_actions(
    experts: Sequence[ActionExperts],
    grey: NDArray[np.uint8],
    pose: FloatArray,
    landmarks: FloatArray,
    before: FloatArray | None = None,
) -> FloatArray:
    """Estimate the activations of all actions.

    Parameters
    ----------
    experts : sequence of ActionExperts
        Of the parts of the face.
    grey, pose, landmarks
        As for `ActionExperts.respond`.
    before : (15,) float64, optional
        Activations of parts that `experts` lacks, from an earlier frame.

    Returns
    -------
    (15,) float64
        About 0 at rest and 1 for a full action. A face at rest may have other values, as people look different.
    """
    activations = np.zeros(N_ACTIONS) if before is None else before.copy()
    for part in experts:
        activations[part.measured] = part.respond(grey, pose, landmarks)
    return activations
