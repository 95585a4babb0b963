"""Covariances: of a process on the skin, by distance along the surface (method.md, section 5.4), and of landmarks, by
which those that are not control points follow the others (section 6.1).

Lips and lids that touch are far apart along the skin, as are the two sides of a fold. A kernel of distance in space
cannot separate them; a process on the surface can, without any cut.

A radial basis function predicts them by distance alone. If their motion in a take is known, a ridge regression
corrects the error of that prediction. It uses only the control points of the same region, and a strong ridge, so
that it also helps with expressions that the take does not contain (docs/accuracy/deformation.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import EYE_LEFT, EYE_RIGHT, outer_eye_distance
from ..heads.regions import REGIONS, membership
from ..mesh.kernels import Kernel, distances
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray, as_points
from ..numeric.linalg import SymmetricSystem

REACH = 0.25
"""Reach of the process in outer-eye distances: the distance along the skin at which the covariance falls to 0.6."""
_LID_REDUCTION = 0.7
"""Share by which the reach is reduced at the lids, whose skin is thin and folds (equation 5.5). It lowered the error at
the eyes by 1 % on ICT-FaceKit and by 4 % on the built-in head."""
_LID_EXTENT = 0.45
"""Distance from the eyes, in outer-eye distances, at which that reduction has fallen to 1/e."""
REGULARISATION = 1e-3
_RIDGE = 0.2
"""Ridge as a share of the mean variance of a region's control points. With 0.2, half the points raise the error by 8
and 6 % (on ICT-FaceKit and the built-in head) for motion that the take contains; for other expressions the error falls
by 0.8 to 6 %."""


_EYES = np.concatenate([EYE_RIGHT, EYE_LEFT])
_MAX_COTANGENT = 20.0
"""Largest cotangent; larger ones, of slivers, are clipped."""


@dataclass(frozen=True)
class SkinCovariance:
    """Covariance of a process on the skin, scaled to 1 on average at the control points.

    Attributes
    ----------
    vertices : (V, P) float32
        Covariance between vertices and control points; 0 if no moving skin joins them.
    control_points : (P, P) float
        Covariance among the control points.
    joined : (V,) bool
        Whether moving skin joins a vertex to a control point.
    """

    vertices: NDArray[np.float32]
    control_points: FloatArray
    joined: NDArray[np.bool_]


def skin_covariance(
    vertices: FloatArray, faces: IntArray, landmarks: IntArray, region_weights: FloatArray
) -> SkinCovariance:
    """Compute the covariance of a Matern process of smoothness 1 on the part of a head that its regions move.

    Arrays are as in `HeadRig`, in any frame. Equation 5.4: ``C = B^-1 M B^-1`` with ``B = M / r^2 + L``, where `L` is
    the cotangent matrix of the surface, `M` contains the areas of the vertices and `r` is the reach. These are the
    finite elements of ``(1 / r^2 - Laplacian) u = noise`` with free borders (Lindgren, Rue & Lindstroem 2011, *An
    explicit link between Gaussian fields and Gaussian Markov random fields*).
    """
    places = as_points(vertices, "vertices", error=HeadError)
    unit = outer_eye_distance(places[landmarks])
    moving = np.asarray(region_weights).any(axis=0)
    used = np.flatnonzero(moving)
    place = np.cumsum(moving) - 1
    # 1. The part of the mesh that the regions move.
    triangles, shares = _triangles(np.asarray(faces, dtype=np.intp))
    inside = moving[triangles].all(axis=1)
    edges, weights, areas = _cotangent_laplacian(places[used], place[triangles[inside]], shares[inside])
    areas = np.maximum(areas, 1e-9 * max(float(areas.max(initial=0.0)), (REACH * unit) ** 2))
    # 2. Reach (equation 5.5), and B = M / r^2 + L, factored once.
    to_eyes = distances(places[landmarks[_EYES]], places[used]).min(axis=0) / unit
    reach = REACH * unit * (1.0 - _LID_REDUCTION * np.exp(-np.square(to_eyes / _LID_EXTENT)))
    pull = np.bincount(edges.ravel(), np.repeat(weights, 2), len(used))
    system = SymmetricSystem(edges, -weights, areas / reach**2 + pull, np.float32)
    # 3. Columns of C = B^-1 M B^-1 at the landmarks (equation 5.4); landmarks at rest have none.
    seeds = np.where(moving[landmarks], place[landmarks], -1)
    values = system.sandwich(seeds, areas)
    columns = np.flatnonzero(seeds >= 0)
    between = np.zeros((len(seeds), len(seeds)))
    between[columns] = values[seeds[columns]]
    # 4. Scale to 1 on average at the landmarks.
    scale = len(columns) / float(np.trace(between)) if len(columns) else 0.0
    values *= np.float32(scale)
    covariance = np.zeros((len(places), len(landmarks)), dtype=np.float32)
    covariance[used] = values
    joined = np.zeros(len(places), dtype=np.bool_)
    # Covariances are not negative. A product is much faster than `any` along short rows.
    joined[used] = values @ np.ones(len(landmarks), dtype=np.float32) > 0.0
    return SkinCovariance(covariance, 0.5 * scale * (between + between.T), joined)


def _cotangent_laplacian(
    vertices: FloatArray, triangles: IntArray, shares: FloatArray
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Return edges (E, 2), their cotangent weights (E,), and the areas of the vertices (V,) (Pinkall & Polthier 1993).

    Edges with negative weights, which lie opposite obtuse angles, are dropped, so that no vertex moves against its
    neighbours.
    """
    # 1. Twice the area of each triangle. Coordinates are separate rows, as numpy is slow along short axes.
    corners = vertices.T[:, triangles.T]
    sides = [corners[:, (i + 2) % 3] - corners[:, (i + 1) % 3] for i in range(3)]
    (ax, ay, az), (bx, by, bz) = sides[0], sides[1]
    across = np.sqrt(np.square(ay * bz - az * by) + np.square(az * bx - ax * bz) + np.square(ax * by - ay * bx))
    # 2. The weight of an edge is half the sum of the cotangents of the opposite angles.
    keys, cotangents = [], []
    scale = shares / np.maximum(across, 1e-30)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        limit = _MAX_COTANGENT * shares
        cotangents.append(np.clip(-np.einsum("ct,ct->t", sides[j], sides[k]) * scale, -limit, limit))
        first, second = triangles[:, j], triangles[:, k]
        keys.append(np.minimum(first, second) * len(vertices) + np.maximum(first, second))
    # 3. Sum over the triangles at each edge, by sorting edges by a single key.
    key = np.concatenate(keys)
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    weights = 0.5 * np.add.reduceat(np.concatenate(cotangents)[order], starts) if len(key) else np.empty(0)
    edges = np.stack(np.divmod(key[starts], len(vertices)), axis=1)
    kept = weights > 0.0
    areas = np.bincount(triangles.ravel(), np.repeat(shares * across / 6.0, 3), len(vertices))
    return edges[kept], weights[kept], np.asarray(areas, dtype=np.float64)


def _triangles(faces: NDArray[np.intp]) -> tuple[NDArray[np.intp], FloatArray]:
    """Divide faces into triangles (T, 3) with weights (T,); quads are split along both diagonals at half weight."""
    corners = (faces >= 0).sum(axis=1)
    parts, shares = [], []
    for count in np.unique(corners[corners > 2]).tolist():
        polygons = faces[corners == count, :count]
        cuts = [(0, i, i + 1) for i in range(1, count - 1)] + ([(0, 1, 3), (1, 2, 3)] if count == 4 else [])
        parts += [polygons[:, cut] for cut in cuts]
        shares.append(np.full(len(polygons) * len(cuts), 0.5 if count == 4 else 1.0))
    return np.concatenate(parts), np.concatenate(shares)


def landmark_covariance(displacements: FloatArray) -> FloatArray:
    """Second moments (66, 66) of the landmarks' `displacements` (N, 66, 3), averaged over frames and axes."""
    moved = np.asarray(displacements, dtype=np.float64).transpose(1, 0, 2).reshape(displacements.shape[1], -1)
    return np.asarray(moved @ moved.T / moved.shape[1])


def follow_in_region(
    phi: FloatArray, covariance: FloatArray | None, chosen: NDArray[np.intp], regularisation: float = REGULARISATION
) -> FloatArray:
    """Compute `F` (P, C) of equation 6.1, from the displacements of C control points to those of all P landmarks.

    `phi` (P, P) is the kernel between the landmarks of the region, and `covariance` (P, P) that of their displacements
    in a take, or None to predict by distance alone.
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
    """Compute the matrix (66, 66) from the displacements of the control points to those of all landmarks.

    Parameters
    ----------
    members : (3, 66) array of bool
        Whether a landmark is a control point of a region, and then of all regions to which it belongs.
    covariance : (66, 66) array or None
        As returned by `landmark_covariance` for a take; None to predict by distance alone.
    sigmas : (3,) array
        Width of the kernel in each region, in the unit of `landmarks`.

    Raises
    ------
    HeadError
        If a region has no control point.

    Notes
    -----
    A landmark of two regions that is not a control point takes the mean of both predictions. Columns of landmarks that
    are not control points are 0.
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
