"""Motion of landmarks that are not control points, which follow those that are (method.md, section 6.1).

A radial basis function predicts them by distance alone. If their motion in a take is known, a ridge regression corrects
the error of that prediction. It uses only the control points of the same region, and a strong ridge, so that it also
helps with expressions that the take does not contain (docs/accuracy/deformation.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..heads.regions import REGIONS, membership
from ..mesh.kernels import Kernel, distances
from ..numeric import linalg
from ..numeric.arrays import FloatArray

REGULARISATION = 1e-3
_RIDGE = 0.2
"""Ridge as a share of the mean variance of a region's control points. With 0.2, half the points raise the error by 8
and 6 % (on ICT-FaceKit and the built-in head) for motion that the take contains; for other expressions the error falls
by 0.8 to 6 %."""


def landmark_covariance(displacements: FloatArray) -> FloatArray:
    """Second moments (66, 66) of the landmarks' `displacements` (N, 66, 3), averaged over frames and axes."""
    moved = np.asarray(displacements, dtype=np.float64).transpose(1, 0, 2).reshape(displacements.shape[1], -1)
    return np.asarray(moved @ moved.T / moved.shape[1])


def follow_in_region(
    phi: FloatArray, covariance: FloatArray | None, chosen: NDArray[np.intp], regularisation: float = REGULARISATION
) -> FloatArray:
    """Compute the matrix from the displacements of a region's control points to those of all its landmarks.

    Parameters
    ----------
    phi : (P, P) array
        Kernel between the landmarks of the region.
    covariance : (P, P) array or None
        Covariance of the landmarks' displacements in a take; None to predict by distance alone.
    chosen : (C,) array of int
        Which of the P landmarks are control points.
    regularisation : float
        As for `RBFDeformer`.

    Returns
    -------
    (P, C) float64
        `F` of equation 6.1.
    """
    pairs = np.ix_(chosen, chosen)
    # F_0: by distance alone.
    matrix = linalg.solve(phi[pairs] + regularisation * np.eye(len(chosen)), phi[chosen]).T
    if covariance is not None and (spread := covariance[pairs]).any():
        # Equation 6.1: regress the error of F_0 on the control points.
        ridge = _RIDGE * np.trace(spread) / len(chosen)
        wrong = covariance[chosen] - spread @ matrix.T
        matrix += linalg.solve(spread + ridge * np.eye(len(chosen)), wrong).T
    matrix[chosen] = np.eye(len(chosen))
    return np.asarray(matrix)


def follow_matrix(
    landmarks: FloatArray,
    members: NDArray[np.bool_],
    covariance: FloatArray | None,
    kernel: Kernel,
    sigmas: FloatArray,
    regularisation: float = REGULARISATION,
) -> FloatArray:
    """Compute the matrix from the displacements of the control points to those of all landmarks.

    Parameters
    ----------
    landmarks : (66, 3) array
        Rest positions.
    members : (3, 66) array of bool
        Whether a landmark is a control point of a region, and then of all regions to which it belongs.
    covariance : (66, 66) array or None
        As returned by `landmark_covariance` for a take; None to predict by distance alone.
    kernel : Kernel
        Kernel of the regions' functions.
    sigmas : (3,) array
        Width of the kernel in each region, in the unit of `landmarks`.
    regularisation : float
        As for `RBFDeformer`.

    Returns
    -------
    (66, 66) float64
        The matrix; columns of landmarks that are not control points are 0.

    Raises
    ------
    HeadError
        If a region has no control point.

    Notes
    -----
    A landmark of two regions that is not a control point takes the mean of both predictions.
    """
    known = members.any(axis=0)
    matrix, said = np.zeros((len(landmarks), len(landmarks))), membership().sum(axis=0)
    for region, row, sigma in zip(REGIONS, members, sigmas.tolist(), strict=True):
        own = region.landmarks
        chosen = np.flatnonzero(known[own])
        if not row.any():
            raise HeadError("The region {name} has no control point. Add one, or use all landmarks.", name=region.name)
        # A landmark of two regions takes the mean of both predictions.
        phi = kernel.phi(distances(landmarks[own], landmarks[own]), sigma)
        among = None if covariance is None else covariance[np.ix_(own, own)]
        matrix[np.ix_(own, own[chosen])] += follow_in_region(phi, among, chosen, regularisation) / said[own, None]
    return matrix
