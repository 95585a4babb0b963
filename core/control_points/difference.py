"""The difference between the skin as moved by some landmarks and by all of them (method.md, section 6.3).

The largest error at a landmark shows when the points suffice, but not how much skin is wrong. Measuring that needs no
true motion, as the skin that all landmarks would give is known for every frame of a take.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..deform.covariance import REGULARISATION, follow_in_region, landmark_covariance
from ..heads.regions import REGIONS
from ..mesh.kernels import Kernel, distances
from ..numeric import linalg
from ..numeric.arrays import FloatArray

_VERTICES = 4_000
"""Largest number of vertices that are evaluated; of more, evenly spaced ones are used."""


class SkinDifference:
    """Weighted sum over vertices of squared distances, averaged over frames.

    Vertices that move more have lower weights, so that the mouth does not take all points from the eyes and brows. The
    cost of a call depends neither on the number of vertices nor on that of frames.

    Parameters
    ----------
    points : (66, 3) array
        Landmarks at rest.
    kernel : Kernel
        Kernel of the regions' functions.
    sigmas : (3,) array
        Width of `kernel` in each region, in the unit of `points`.
    displacements : (N, 66, 3) array
        Displacements of the landmarks in each frame, in the unit of `points`.
    vertices : (V, 3) array
        Positions on the skin.
    region_weights : (3, V) array
        As for `RBFDeformer`.

    Notes
    -----
    Equation 6.2: ``tr(G^T E^T W E G S)`` with ``G = K (F - I)``, summed over regions. S is the mean of d d^T over
    frames and axes, E the kernel between vertices and landmarks times the region weights, W the weights of the
    vertices, K the inverse of the regularised kernel matrix, and F the matrix from chosen landmarks to all.
    """

    def __init__(
        self,
        points: FloatArray,
        kernel: Kernel,
        sigmas: FloatArray,
        displacements: FloatArray,
        vertices: FloatArray,
        region_weights: FloatArray,
    ) -> None:
        every = -(-len(vertices) // _VERTICES)
        places, painted = np.asarray(vertices, dtype=np.float64)[::every], np.asarray(region_weights)[:, ::every]
        shares = painted / np.maximum(painted.sum(axis=0), 1.0)
        # Everything that does not depend on the choice of points is computed here, so that a call multiplies only small
        # matrices.
        covariance = landmark_covariance(displacements)
        parts, squared = [], np.zeros(len(places))
        for region, sigma, share in zip(REGIONS, sigmas.tolist(), shares, strict=True):
            own = points[region.landmarks]
            phi = kernel.phi(distances(own, own), sigma)
            full = linalg.inv(phi + REGULARISATION * np.eye(len(own)))
            evaluation = share[:, None] * kernel.phi(distances(places, own), sigma)
            alike = covariance[np.ix_(region.landmarks, region.landmarks)]
            matrix = linalg.multiply(evaluation, full)
            squared += np.sum(linalg.multiply(matrix, alike) * matrix, axis=1)
            parts.append((region.landmarks, phi, full, alike, evaluation))
        # Weights of the vertices: the inverse of their rms motion plus its mean, which keeps resting ones finite.
        motion = np.sqrt(np.maximum(squared, 0.0))
        weights = 1.0 / np.maximum(motion + motion.mean(), 1e-30)
        self._parts = [
            (*part, linalg.multiply(evaluation.T, weights[:, None] * evaluation)) for *part, evaluation in parts
        ]

    def __call__(self, members: NDArray[np.bool_]) -> float:
        """Return the difference for the control points `members`, (3, 66); infinite if a region has none."""
        if not members.any(axis=1).all():
            return np.inf
        total = 0.0
        for row, (landmarks, phi, full, alike, reach) in zip(members, self._parts, strict=True):
            chosen = np.flatnonzero(row[landmarks])
            difference = -full
            difference[:, chosen] += full @ follow_in_region(phi, alike, chosen)
            total += float(np.sum((reach @ difference) * (difference @ alike)))
        return total
