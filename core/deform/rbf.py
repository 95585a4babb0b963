"""Gaussian radial basis functions, one for each region, prepared once so that a frame is a few matrix products.

The paper refits the weights in every frame. Rest positions do not change, so neither does the matrix of the fit: it is
solved once here, together with the evaluation at every vertex, and a frame costs the product alone. Solved, never
inverted: Gaussians become ill-conditioned as sigma grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, as_points
from ..errors import HeadError

MAX_CONDITION = 1e10


@dataclass(frozen=True)
class RegionBlock:
    """One region's part of the deformer.

    Attributes
    ----------
    rows : (Vr,) intp
        The vertices that the region moves.
    columns : (Pr,) intp
        The control points that move it.
    matrix : (Vr, Pr) float32
        `phi(|x - c|) Phi^-1`, times the vertex' share of the region.
    sigma : float
        Width of the Gaussian, metres.
    condition : float
        Condition number of the regularised Phi.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    matrix: NDArray[np.float32]
    sigma: float
    condition: float


class RBFDeformer:
    """Moves a mesh by the displacements of its control points.

    Solvable where the control points of each region are distinct and sigma is not far above their spacing.

    Parameters
    ----------
    vertices : (V, 3) array_like
        Rest positions, any frame and unit.
    control_points : (P, 3) array_like
        Rest positions of the control points, same frame.
    region_weights : (R, V) array_like
        Share of each region in each vertex, >= 0; normalised to a sum of one where the sum exceeds one, so that a
        vertex on a border takes the weighted mean of its regions (the paper's mean for weights of 0 and 1), and one
        where the paint fades out moves less.
    membership : (R, P) array_like of bool
        Which control point controls which region.
    sigma : float, optional
        Width of the Gaussians; by default `spacing_factor` times the median distance of a region's control points to
        their third nearest neighbour.
    spacing_factor : float or (R,) array_like
        One for all regions, or one for each.
    regularisation : float
        Added to the diagonal of Phi, whose entries are at most one. At 0.001 vertices between control points
        follow more smoothly than at nothing, and the points themselves are met within 0.05 mm on the face units.

    Raises
    ------
    HeadError
        Coincident control points, a region with vertices but without control points, an ill-conditioned fit.

    Notes
    -----
    Preparation costs O(R P^3 + V P); a frame costs V P multiply-adds a coordinate.

    References
    ----------
    Yao, Li, Li & Su 2019, equations (1) to (3), section 4.1.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        control_points: ArrayLike,
        region_weights: ArrayLike,
        membership: ArrayLike,
        *,
        sigma: float | None = None,
        spacing_factor: ArrayLike = 0.8,
        regularisation: float = 1e-3,
    ) -> None:
        rest = as_points(vertices, "vertices", error=HeadError)
        points = as_points(control_points, "control_points", error=HeadError)
        members = np.asarray(membership, dtype=np.bool_)
        weights = _shares(region_weights, len(members), len(rest))
        if members.shape != (len(weights), len(points)):
            raise HeadError(f"membership must be ({len(weights)}, {len(points)}); got {members.shape}.")
        factors = np.broadcast_to(np.asarray(spacing_factor, dtype=np.float64), len(members))
        self.rest: NDArray[np.float32] = rest.astype(np.float32)
        self.n_control_points = len(points)
        self.blocks = tuple(
            _region_block(rest, points, share, np.flatnonzero(member), sigma, float(factor), regularisation)
            for share, member, factor in zip(weights, members, factors, strict=True)
            if share.any()
        )
        if not self.blocks:
            raise HeadError("No vertex lies in a region. Paint the regions Upper, Middle and Lower as vertex groups.")

    def deform(self, displacements: ArrayLike, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the deformed vertices, (V, 3) float32, written into `out` where given.

        Parameters
        ----------
        displacements : (P, 3) array_like
            Of the control points from their rest positions, frame and unit of `vertices`.
        """
        moved = as_points(displacements, "displacements", count=self.n_control_points, dtype=np.float32)
        result = np.empty_like(self.rest) if out is None else out
        np.copyto(result, self.rest)
        for block in self.blocks:
            result[block.rows] += block.matrix @ moved[block.columns]
        return result


def gaussian(distance: FloatArray, sigma: float) -> FloatArray:
    """phi(r) = exp(-r^2 / (2 sigma^2)), equation (2)."""
    return np.asarray(np.exp(-np.square(distance) / (2.0 * sigma * sigma)))


def _shares(region_weights: ArrayLike, n_regions: int, n_vertices: int) -> FloatArray:
    weights = np.asarray(region_weights, dtype=np.float64)
    if weights.shape != (n_regions, n_vertices):
        raise HeadError(f"region_weights must be ({n_regions}, {n_vertices}); got {weights.shape}.")
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise HeadError("region_weights must be finite and not negative.")
    return np.asarray(weights / np.maximum(weights.sum(axis=0), 1.0))


def _region_block(
    rest: FloatArray,
    points: FloatArray,
    share: FloatArray,
    columns: NDArray[np.intp],
    sigma: float | None,
    spacing_factor: float,
    regularisation: float,
) -> RegionBlock:
    if len(columns) == 0:
        raise HeadError("A region has vertices but no control point. Bind its landmarks, or clear its vertex group.")
    centres = points[columns]
    between = _distances(centres, centres)
    nearest = np.where(np.eye(len(columns), dtype=bool), np.inf, between).min(axis=1)
    if len(columns) > 1 and nearest.min() < 1e-6 * between.max():
        pair = columns[np.argmin(nearest)]
        raise HeadError(f"Control point {pair} lies on another one. Bind the two to different vertices.")
    if sigma is None:
        sigma = spacing_factor * _spacing(between)
    kernel = gaussian(between, sigma) + regularisation * np.eye(len(columns))
    condition = float(np.linalg.cond(kernel))
    if condition > MAX_CONDITION:
        raise HeadError(
            f"The fit is ill-conditioned (condition number {condition:.1e} at sigma {sigma:.3g}). "
            "Lower sigma, or raise the regularisation."
        )
    rows = np.flatnonzero(share)
    evaluation = gaussian(_distances(rest[rows], centres), sigma)
    matrix = np.linalg.solve(kernel, evaluation.T).T * share[rows, None]
    return RegionBlock(rows, columns, np.ascontiguousarray(matrix, dtype=np.float32), float(sigma), condition)


def _distances(a: FloatArray, b: FloatArray) -> FloatArray:
    squared = (a * a).sum(1)[:, None] + (b * b).sum(1)[None] - 2.0 * (a @ b.T)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _spacing(between: FloatArray) -> float:
    if len(between) == 1:
        return 1.0
    rank = min(3, len(between) - 1)
    return float(np.median(np.sort(between, axis=1)[:, rank]))
