"""Where a fit begins: from a detector's box, by learnt regressions, to a pose and the first shape modes.

A mean face dropped into a Viola-Jones box is often out of reach of the patch experts. A few linear regressions on
gradient histograms, each looking from where the last one ended, bring it near (supervised descent, Xiong & De la
Torre 2013).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import exp

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .pdm import N_POSE, FittedShape, PointDistributionModel
from .reference import warp_to_reference

WINDOW = 64
SCALE = 22.0
"""Pixels an outer-eye distance in the 64 x 64 window: the face from brow to chin with a third around it."""
N_START_MODES = 16


@cache
def _histogram() -> cv2.HOGDescriptor:
    return cv2.HOGDescriptor((WINDOW, WINDOW), (16, 16), (8, 8), (8, 8), 9)


def gradient_features(grey: NDArray[np.uint8], pose: FloatArray) -> NDArray[np.float32]:
    """(1765,) histograms of oriented gradients (Dalal & Triggs 2005) of the face at `pose`, unrolled, and a 1."""
    window = warp_to_reference(grey, pose, SCALE, WINDOW).pixels.astype(np.uint8)
    features = _histogram().compute(window).ravel()  # type: ignore[attr-defined]
    return np.append(features, np.float32(1.0))


@dataclass(frozen=True)
class StartModel:
    """Learnt ways from a detector's box to a start.

    Attributes
    ----------
    box_offset : (D, 3) float64
        For each detector: the pose's translation from the box's centre (x, y) and its scale, in box widths.
    steps : (S, 1765, 6 + M) float32
        Regressions from gradient features to `(d log s, d pitch, d yaw, d roll, dx, dy, dq)`; dx and dy are outer-eye
        distances along the unrolled face.
    """

    box_offset: FloatArray
    steps: NDArray[np.float32]

    def pose_in_box(self, box: FloatArray, detector: int, roll: float = 0.0) -> FloatArray:
        """(6,) frontal pose for a box `(x, y, width, height)` in pixels, found by the given detector."""
        dx, dy, scale = self.box_offset[detector]
        x, y, width, height = box
        return np.array([scale * width, 0.0, 0.0, roll, x + width * (0.5 + dx), y + 0.5 * height + width * dy])

    def refine(self, model: PointDistributionModel, grey: NDArray[np.uint8], pose: FloatArray) -> FittedShape:
        """Walk the regressions from `pose`; about 0.3 ms a step."""
        fitted = FittedShape(pose, np.zeros(model.n_modes))
        for regression in self.steps:
            update = gradient_features(grey, fitted.pose) @ regression
            fitted = apply_update(model, fitted, update.astype(np.float64))
        return fitted


def apply_update(model: PointDistributionModel, fitted: FittedShape, update: FloatArray) -> FittedShape:
    """`fitted` moved by one regression's output (6 + M,); the pose stays within what a face in view can have."""
    pose, shape_params = fitted.pose.copy(), fitted.shape_params.copy()
    c, s = np.cos(pose[3]), np.sin(pose[3])
    pose[4:6] += pose[0] * np.array([c * update[4] - s * update[5], s * update[4] + c * update[5]])
    pose[0] *= exp(float(np.clip(update[0], -0.5, 0.5)))
    pose[1:4] += np.clip(update[1:4], -0.8, 0.8)
    pose[1:3] = np.clip(pose[1:3], (-0.8, -1.3), (0.8, 1.3))
    modes = len(update) - N_POSE
    shape_params[:modes] += update[N_POSE:]
    return FittedShape(pose, model.clamp(shape_params))
