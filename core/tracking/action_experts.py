"""Experts of actions: small networks that measure what no landmark shows (method.md, section 3.11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..face.actions import ACTION_MIRROR, N_ACTIONS
from ..numeric.arrays import FloatArray, IntArray
from .experts import FacePart


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
            Pose of the face, in the image frame.
        landmarks : (66, 2) float64
            Landmarks in pixels.

        Returns
        -------
        (k,) or (2 k,) float64
            Activations of the actions in `measured`.
        """
        poses = pose[None].repeat(len(self.sides), axis=0)
        poses[:, 4:6] = landmarks[self.sides].mean(axis=1)
        (activations,) = self.network(self.crops(grey, poses))
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
        Experts of the parts of the face that are measured.
    grey, pose, landmarks
        As for `ActionExperts.respond`.
    before : (15,) float64, optional
        Activations from an earlier frame, kept for parts without experts in `experts`.

    Returns
    -------
    (15,) float64
        Activations, about 0 at rest and 1 for a full action. They may differ from 0 at rest, as people look different.
    """
    activations = np.zeros(N_ACTIONS) if before is None else before.copy()
    for part in experts:
        activations[part.measured] = part.respond(grey, pose, landmarks)
    return activations
