"""Regularised landmark mean-shift (Saragih, Lucey & Cohn, IJCV 91, 2011), the fit of shape to response maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import cv2
import numpy as np

from ..arrays import FloatArray, IntArray
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
        The `rho` of the prior's share `rho L`, in the same unit. One value for all iterations.
    doubt : float
        Distance from the shape, in the unit of the fit's frame, at which a map's mean makes it count half from the
        second iteration on: a hand before the face draws a few landmarks far away.
    """

    variances: tuple[float, ...]
    regularisation: float
    doubt: float = inf


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
    Doubt weighs as the Cauchy distribution does, by iteratively reweighted least squares (Holland & Welsch 1977).
    """
    jacobian = model.jacobian(start.pose, start.shape_params)
    flat = jacobian.reshape(-1, jacobian.shape[2])
    prior = np.zeros(flat.shape[1])
    np.divide(options.regularisation, model.eigenvalues, out=prior[N_POSE:])
    of = np.concatenate([e.maps.landmarks for e in evidence])
    weights = trusted = np.concatenate([e.weights for e in evidence])
    normal = _normal_matrix(flat, prior, of, weights)
    # The derivative by the scale is where the landmarks are, over the scale.
    landmarks = (start.pose[0] * jacobian[:, :, 0] + start.pose[4:6, None]).T
    moved = np.zeros(len(prior))
    for i, variance in enumerate(options.variances):
        places = landmarks[of]
        shifts = _shifts(evidence, places, variance)
        if i and options.doubt < inf:
            away = shifts if variance == inf else _shifts(evidence, places, inf)
            weights = trusted * (options.doubt**2 / (options.doubt**2 + np.square(away).sum(axis=1)))
            normal = _normal_matrix(flat, prior, of, weights)
        pull = [np.bincount(of, weights * shift, len(landmarks)) for shift in shifts.T]
        right = np.concatenate(pull) @ flat
        right[N_POSE:] -= prior[N_POSE:] * (start.shape_params + moved[N_POSE:])
        # By OpenCV, as numpy's would set threads to this small matrix, which on a busy machine wait for each other.
        delta = cv2.solve(normal, right, flags=cv2.DECOMP_CHOLESKY)[1][:, 0]
        moved += delta
        landmarks += (flat @ delta).reshape(2, -1).T
    return model.step(start.pose, start.shape_params, moved)


def _shifts(evidence: Sequence[Evidence], places: FloatArray, variance: float) -> FloatArray:
    """(n, 2) where all maps together draw the landmarks at `places` (n, 2)."""
    drawn, first = np.empty_like(places), 0
    for e in evidence:
        own = slice(first, first + len(e.weights))
        drawn[own] = e.maps.shifts(places[own], inf if e.coarse else variance)
        first = own.stop
    return drawn


def _normal_matrix(flat: FloatArray, prior: FloatArray, of: IntArray, weights: FloatArray) -> FloatArray:
    """`rho L + J^T W J` where each of the maps `of` landmarks (n,) has its weight (n,)."""
    total = np.bincount(of, weights, len(flat) // 2)
    normal = flat.T @ (flat * np.concatenate([total, total])[:, None])
    # A landmark set of weight 0 leaves the pose free; the small number keeps the system solvable, and the step is 0.
    normal.reshape(-1)[:: len(prior) + 1] += prior + 1e-9
    return np.asarray(normal)
