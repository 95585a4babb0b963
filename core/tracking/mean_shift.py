"""Regularised landmark mean-shift (Saragih, Lucey & Cohn, IJCV 91, 2011), the fit of shape to response maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import cv2
import numpy as np

from ..arrays import FloatArray
from .experts import ResponseMaps
from .pdm import N_POSE, FittedShape, PointDistributionModel


@dataclass(frozen=True)
class Evidence:
    """Response maps, and how far each is trusted.

    Attributes
    ----------
    maps : ResponseMaps
    weights : (n,) float64
        The diagonal of `W`.
    coarse : bool
        Whether the maps are too coarse for more than their means.
    """

    maps: ResponseMaps
    weights: FloatArray
    coarse: bool = False


@dataclass(frozen=True)
class MeanShiftOptions:
    """How one set of response maps is climbed.

    Attributes
    ----------
    variances : tuple of float
        `rho`, one for each iteration, in the squared unit of the fit's frame: wide kernels first, so that no local
        maximum holds the shape; infinity goes to each map's mean.
    regularisation : float
        The `rho` of the prior's share `rho L`, in the same unit. One value for all iterations, so that the normal
        matrix is formed once.
    """

    variances: tuple[float, ...]
    regularisation: float


def regularised_mean_shift(
    model: PointDistributionModel, start: FittedShape, evidence: Sequence[Evidence], options: MeanShiftOptions
) -> FittedShape:
    """Move pose and shape to the peak of the responses that the shape model allows.

    Parameters
    ----------
    start : FittedShape
        In the frame of the maps.
    evidence : sequence of Evidence
        A landmark may have several maps, or none.

    Notes
    -----
    Each step is `dp = -(rho L + J^T W J)^-1 (rho L p - J^T W v)` with `L = diag(0, 1 / lambda)`; in the end the
    coefficients are kept within three standard deviations. The maps and the Jacobian are those of the start, and the
    landmarks move along it: where the pose turns far, call again from the result. About 0.1 ms and 0.06 ms a step.
    """
    jacobian = model.jacobian(start.pose, start.shape_params)
    flat = jacobian.reshape(-1, jacobian.shape[2])
    weights = np.zeros(jacobian.shape[1])
    for e in evidence:
        weights[e.maps.landmarks] += e.weights
    prior = np.zeros(flat.shape[1])
    np.divide(options.regularisation, model.eigenvalues, out=prior[N_POSE:])
    normal = flat.T @ (flat * np.concatenate([weights, weights])[:, None])
    # A landmark set of weight 0 leaves the pose free; the small number keeps the system solvable, and the step is 0.
    normal.reshape(-1)[:: len(prior) + 1] += prior + 1e-9
    # The derivative by the scale is where the landmarks are, over the scale.
    landmarks = (start.pose[0] * jacobian[:, :, 0] + start.pose[4:6, None]).T
    moved = np.zeros(len(prior))
    for variance in options.variances:
        pull = np.zeros(landmarks.shape)
        for e in evidence:
            shift = e.maps.shifts(landmarks[e.maps.landmarks], inf if e.coarse else variance)
            shift *= e.weights[:, None]
            pull[e.maps.landmarks] += shift
        right = pull.T.reshape(-1) @ flat
        right[N_POSE:] -= prior[N_POSE:] * (start.shape_params + moved[N_POSE:])
        # By OpenCV, as numpy's would set threads to this small matrix, which on a busy machine wait for each other.
        delta = cv2.solve(normal, right, flags=cv2.DECOMP_CHOLESKY)[1][:, 0]
        moved += delta
        landmarks += (flat @ delta).reshape(2, -1).T
    return model.step(start.pose, start.shape_params, moved)
