"""Regularised landmark mean-shift (Saragih, Lucey & Cohn, IJCV 91, 2011), the fit of shape to response maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .patch_experts import ResponseMaps
from .pdm import N_POSE, FittedShape, PointDistributionModel, solve_update


@dataclass(frozen=True)
class MeanShiftOptions:
    """How one set of response maps is climbed.

    Attributes
    ----------
    variances : tuple of float
        `rho` in px^2, one for each iteration: wide kernels first, so that no local maximum holds the shape.
    regularisation : float
        Multiplies the prior's share `rho L`.
    """

    variances: tuple[float, ...]
    regularisation: float = 1.0


def mean_shifts(maps: ResponseMaps, landmarks: FloatArray, variance: float) -> FloatArray:
    """(2, N) `v`: from each landmark (N, 2) to its responses' mean under a Gaussian round it (eq. 20).

    The Gaussian is separable, so the weights are never formed.
    """
    side = maps.probability.shape[1]
    steps = np.arange(side)
    to_x = (maps.corner[:, :1] + steps - landmarks[:, :1]).astype(np.float32)
    to_y = (maps.corner[:, 1:] + steps - landmarks[:, 1:]).astype(np.float32)
    near_x, near_y = np.exp(to_x * to_x / (-2.0 * variance)), np.exp(to_y * to_y / (-2.0 * variance))
    along = np.matmul(maps.probability, np.stack([near_x, near_x * to_x], axis=2))
    down = np.stack([near_y, near_y * to_y], axis=1)
    sums = np.matmul(down, along)
    # A landmark far outside its window sees only zeros and is drawn nowhere.
    total = np.maximum(sums[:, 0, 0], 1e-20)
    shift: FloatArray = np.stack([sums[:, 0, 1] / total, sums[:, 1, 0] / total]).astype(np.float64)
    return shift


def regularised_mean_shift(
    model: PointDistributionModel,
    start: FittedShape,
    maps: ResponseMaps,
    weights: FloatArray,
    options: MeanShiftOptions,
) -> FittedShape:
    """Move pose and shape to the peak of the responses that the shape model allows.

    Parameters
    ----------
    start : FittedShape
        In the reference frame.
    maps : ResponseMaps
        Of the reference frame; not evaluated again between iterations.
    weights : (N,)
        Visibility and confidence, the diagonal of `W` (identity in the paper).

    Notes
    -----
    Each step solves `dp = -(rho L + J^T W J)^-1 (rho L p - J^T W v)` with `L = diag(0, 1 / lambda)`, and keeps the
    coefficients within three standard deviations.
    """
    fitted = start
    precision = np.concatenate([np.zeros(N_POSE), options.regularisation / model.eigenvalues])
    for variance in options.variances:
        landmarks = model.project(fitted.pose, fitted.shape_params)
        shift = mean_shifts(maps, landmarks, variance)
        jacobian = model.jacobian(fitted.pose, fitted.shape_params)
        delta = solve_update(jacobian, shift, weights, variance * precision, fitted.shape_params)
        fitted = model.step(fitted.pose, fitted.shape_params, delta)
    return fitted
