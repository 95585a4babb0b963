"""How far the skin that some landmarks move lies from the skin that all of them move: what the choice of points costs.

The largest error at a landmark says when points suffice, but not how much skin is wrong by it. That needs no true
motion: the skin that all landmarks give is known for every frame of a take.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..deform.follow import REGULARISATION, follow_in_region, landmark_covariance
from ..heads.regions import REGIONS
from ..mesh.kernels import Kernel, distances

_VERTICES = 4_000
"""More say no more, and are passed over evenly."""


class SkinDifference:
    """Sum of squared distances over vertices, mean over frames; what a call costs depends on neither number.

    A vertex counts the less the more it moves, so that the mouth does not take all the points of eyes and brows.

    Parameters
    ----------
    points : (66, 3) array
        The landmarks at rest.
    sigmas : (3,) array
        Width of `kernel` in each region.
    displacements : (N, 66, 3) array
        Of the landmarks in each frame, unit of `points`.
    vertices : (V, 3) array
        Places on the skin.
    region_weights : (3, V) array
        As `RBFDeformer` takes them.

    Notes
    -----
    With S the mean of d d^T over frames and axes, E the kernel between vertices and landmarks times the vertices'
    shares, W the vertices' weights, and B = phi^-1 (F - 1) with F the way in which all landmarks follow the chosen
    ones, it is the trace of B^T E^T W E B S, summed over regions.
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
        covariance = landmark_covariance(displacements)
        parts, squared = [], np.zeros(len(places))
        for region, sigma, share in zip(REGIONS, sigmas.tolist(), shares, strict=True):
            own = points[region.landmarks]
            phi = kernel.phi(distances(own, own), sigma)
            full = np.linalg.inv(phi + REGULARISATION * np.eye(len(own)))
            evaluation = share[:, None] * kernel.phi(distances(places, own), sigma)
            alike = covariance[np.ix_(region.landmarks, region.landmarks)]
            matrix = evaluation @ full
            squared += np.sum((matrix @ alike) * matrix, axis=1)
            parts.append((region.landmarks, phi, full, alike, evaluation))
        motion = np.sqrt(np.maximum(squared, 0.0))
        weights = 1.0 / np.maximum(motion + motion.mean(), 1e-30)
        self._parts = [(*part, evaluation.T @ (weights[:, None] * evaluation)) for *part, evaluation in parts]

    def __call__(self, members: NDArray[np.bool_]) -> float:
        """For the control points `members` (3, 66); infinite where a region has none."""
        if not members.any(axis=1).all():
            return np.inf
        total = 0.0
        for row, (landmarks, phi, full, alike, reach) in zip(members, self._parts, strict=True):
            chosen = np.flatnonzero(row[landmarks])
            difference = -full
            difference[:, chosen] += full @ follow_in_region(phi, alike, chosen)
            total += float(np.sum((reach @ difference) * (difference @ alike)))
        return total
