"""How landmarks that are no control points follow those that are: by distance, and as they did in a take.

A radial basis function says by distance alone where the others go. In the take from which the points were chosen it is
known where they went, and a ridge regression of what distance gets wrong on the control points of the same region
corrects it. The same region alone, and with a strong ridge: so it helps with expressions too that the take did not have
(docs/deformation.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import HeadError
from ..heads.regions import REGIONS, membership
from ..mesh.kernels import Kernel, distances

REGULARISATION = 1e-3
_RIDGE = 0.2
"""Of the mean variance of a region's control points."""


def landmark_covariance(displacements: FloatArray) -> FloatArray:
    """(66, 66) mean over frames and axes of the products of landmarks' (N, 66, 3) `displacements`."""
    moved = np.asarray(displacements, dtype=np.float64).transpose(1, 0, 2).reshape(displacements.shape[1], -1)
    return np.asarray(moved @ moved.T / moved.shape[1])


def follow_in_region(phi: FloatArray, covariance: FloatArray | None, chosen: NDArray[np.intp]) -> FloatArray:
    """(P, C) matrix from the displacements of a region's `chosen` landmarks to those of all its landmarks.

    Parameters
    ----------
    phi : (P, P) array
        Kernel between the landmarks of the region.
    covariance : (P, P) array, optional
        Of their displacements in a take; without it distance alone says how they follow.
    chosen : (C,) array of int
        Which of the P are control points.
    """
    pairs = np.ix_(chosen, chosen)
    matrix = np.linalg.solve(phi[pairs] + REGULARISATION * np.eye(len(chosen)), phi[chosen]).T
    if covariance is not None and (spread := covariance[pairs]).any():
        ridge = _RIDGE * np.trace(spread) / len(chosen)
        wrong = covariance[chosen] - spread @ matrix.T
        matrix += np.linalg.solve(spread + ridge * np.eye(len(chosen)), wrong).T
    matrix[chosen] = np.eye(len(chosen))
    return np.asarray(matrix)


def following(
    landmarks: FloatArray,
    members: NDArray[np.bool_],
    covariance: FloatArray | None,
    kernel: Kernel,
    sigmas: FloatArray,
) -> FloatArray:
    """(66, 66) matrix from the displacements of the control points, other columns being 0, to those of all landmarks.

    Parameters
    ----------
    landmarks : (66, 3) array
        Rest positions.
    members : (3, 66) array of bool
        Which landmark is a control point of which region: of one, and so of all that it belongs to.
    covariance : (66, 66) array, optional
        As `landmark_covariance` gives it for a take.
    kernel, sigmas
        Of the regions' functions.

    Raises
    ------
    HeadError
        Where a region has no control point.

    Notes
    -----
    A landmark of two regions that is no control point takes the mean of what both say.
    """
    known = members.any(axis=0)
    matrix, said = np.zeros((len(landmarks), len(landmarks))), membership().sum(axis=0)
    for region, row, sigma in zip(REGIONS, members, sigmas.tolist(), strict=True):
        own = region.landmarks
        chosen = np.flatnonzero(known[own])
        if not row.any():
            raise HeadError(f"The region {region.name} has no control point. Add one, or use all landmarks.")
        phi = kernel.phi(distances(landmarks[own], landmarks[own]), sigma)
        among = None if covariance is None else covariance[np.ix_(own, own)]
        matrix[np.ix_(own, own[chosen])] += follow_in_region(phi, among, chosen) / said[own, None]
    return matrix
