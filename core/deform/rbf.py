"""Radial basis functions, one for each region, prepared once so that a frame is a few matrix products.

The paper refits the weights in every frame. Rest positions do not change, so neither does the matrix of the fit: it is
solved once here, together with the evaluation at every vertex, and a frame costs the product alone. Solved, never
inverted: Gaussians become ill-conditioned as sigma grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, as_points
from ..errors import HeadError
from ..mesh.kernels import Kernel, distances, kernel_named
from .blocks import BlockProduct, RegionMatrix
from .skin import SkinCovariance

MAX_CONDITION = 1e10
_SKIN_SHARE = 0.6
"""Of the process on the skin in the mean with the regions' functions."""
_CHUNK = 4_000
"""Vertices fitted at a time: what they need stays in the processor's second cache."""


@dataclass(frozen=True)
class RegionFit:
    """One region's fit, as it came out.

    Attributes
    ----------
    rows : (Vr,) intp
        The vertices that the region moves.
    columns : (Pr,) intp
        The control points that move it.
    sigma : float
        Width of the kernel, unit of the vertices.
    condition : float
        Condition number of the regularised Phi.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
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
    kernel : str
        A name in `kernels.KERNELS`; the paper's Gaussian by default.
    sigma : float or (R,) array_like, optional
        Width of the kernel, one for all regions or one for each; by default chosen from the spacing of a region's
        control points, times `spacing_factor`.
    spacing_factor : float or (R,) array_like
        One for all regions, or one for each.
    regularisation : float
        Added to the diagonal of Phi, whose entries are at most one. At 0.001 vertices between control points
        follow more smoothly than at nothing, and the points themselves are met within 0.5 mm on the face units.
    skin : SkinCovariance, optional
        A process on the mesh's surface, over all control points. What it joins to any of them takes a weighted mean of
        it and of the regions' functions.
    follow : (P, P) array_like, optional
        Displacements of all control points from those that are given, as `follow.following` tells; columns of those
        that are not given are 0. All are given by default.

    Attributes
    ----------
    rest : (V, 3) float32
    fits : tuple of RegionFit
        Of the regions that have vertices.
    nbytes : int
        Memory that the matrices take.

    Raises
    ------
    HeadError
        Coincident control points, a region with vertices but without control points, an ill-conditioned fit.

    Notes
    -----
    Preparation costs O(R P^3 + V P); a frame costs V P multiply-adds a coordinate, P those of the vertex' regions.
    An instance holds the buffers of a frame: threads need one each.

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
        kernel: str = "gaussian",
        sigma: ArrayLike | None = None,
        spacing_factor: ArrayLike = 0.8,
        regularisation: float = 1e-3,
        skin: SkinCovariance | None = None,
        follow: ArrayLike | None = None,
    ) -> None:
        rest = as_points(vertices, "vertices", error=HeadError)
        points = as_points(control_points, "control_points", error=HeadError)
        members = np.asarray(membership, dtype=np.bool_)
        shares = _shares(region_weights, len(members), len(rest))
        if members.shape != (len(shares), len(points)):
            raise HeadError(f"membership must be ({len(shares)}, {len(points)}); got {members.shape}.")
        factors = np.broadcast_to(np.asarray(spacing_factor, dtype=np.float64), len(members))
        if sigma is not None and not (np.asarray(sigma) > 0).all():
            raise HeadError(f"sigma must be above 0; got {sigma!r}.")
        widths = [None] * len(members) if sigma is None else np.broadcast_to(np.asarray(sigma), len(members)).tolist()
        fit = _Fit(rest, points, kernel_named(kernel), regularisation)
        regions = [
            fit.region(shares[row], np.flatnonzero(members[row]), widths[row], float(factors[row]))
            for row in range(len(members))
            if shares[row].any()
        ]
        if not regions:
            raise HeadError("No vertex lies in a region. Paint the regions Upper, Middle and Lower as vertex groups.")
        matrices = [matrix for _, matrix in regions]
        if skin is not None:
            used = np.flatnonzero(members[shares.any(axis=1)].any(axis=0))
            matrices = _mean(matrices, fit.surface(skin, shares.sum(axis=0), used), len(rest))
        if follow is not None:
            matrices = [_followed(matrix, np.asarray(follow, dtype=np.float32)) for matrix in matrices]
        self.rest: NDArray[np.float32] = rest.astype(np.float32)
        self.n_control_points = len(points)
        self.fits = tuple(found for found, _ in regions)
        self._product = BlockProduct(self.rest, matrices, len(points))
        self.nbytes = self._product.nbytes

    def deform(self, displacements: ArrayLike, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the deformed vertices, (V, 3) float32, written into `out` where given.

        Parameters
        ----------
        displacements : (P, 3) array_like
            Of the control points from their rest positions, frame and unit of `vertices`.
        out : (V, 3) float32, C-contiguous, optional
        """
        moved = np.asarray(displacements, dtype=np.float32)
        if moved.shape != (self.n_control_points, 3) or not math.isfinite(np.vdot(moved, moved)):
            as_points(displacements, "displacements", count=self.n_control_points)
        result = np.empty_like(self.rest) if out is None else out
        if result.shape != self.rest.shape or result.dtype != np.float32 or not result.flags.c_contiguous:
            raise ValueError(f"out must be {self.rest.shape}, float32 and C-contiguous")
        self._product.apply(moved, result)
        return result

    def matrix(self) -> NDArray[np.float32]:
        """The whole (V, P) matrix A of `rest + A d`: for analysis; a frame never needs it."""
        columns = []
        unit = np.zeros((self.n_control_points, 3), dtype=np.float32)
        for column in range(self.n_control_points):
            unit[column, 0] = 1.0
            columns.append((self.deform(unit) - self.rest)[:, 0])
            unit[column, 0] = 0.0
        return np.stack(columns, axis=1)


class IncrementalDeformer:
    """The paper's own way: every frame is fitted anew from the coordinates of the one before (section 3.2).

    It costs a hundred times as much as `RBFDeformer`, and what a frame gets wrong the next one keeps; here for
    comparison.

    Parameters
    ----------
    vertices, control_points, region_weights, membership, **options
        As for `RBFDeformer`.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        control_points: ArrayLike,
        region_weights: ArrayLike,
        membership: ArrayLike,
        **options: Any,
    ) -> None:
        self._points = as_points(control_points, "control_points", error=HeadError)
        self._regions = np.asarray(region_weights), np.asarray(membership)
        self._options = options
        self.rest: NDArray[np.float32] = as_points(vertices, "vertices", error=HeadError).astype(np.float32)
        self.n_control_points = len(self._points)
        self.reset()

    def reset(self) -> None:
        """Start again from rest."""
        self._vertices = self.rest.astype(np.float64)
        self._moved = np.zeros_like(self._points)

    def deform(self, displacements: ArrayLike, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """As `RBFDeformer.deform`, from the frame before: the result hangs on all frames since `reset`."""
        moved = as_points(displacements, "displacements", count=self.n_control_points)
        step = RBFDeformer(self._vertices, self._points + self._moved, *self._regions, **self._options)
        result = step.deform(moved - self._moved, out)
        self._vertices, self._moved = result.astype(np.float64), np.asarray(moved)
        return result


def _shares(region_weights: ArrayLike, n_regions: int, n_vertices: int) -> FloatArray:
    weights = np.asarray(region_weights, dtype=np.float64)
    if weights.shape != (n_regions, n_vertices):
        raise HeadError(f"region_weights must be ({n_regions}, {n_vertices}); got {weights.shape}.")
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise HeadError("region_weights must be finite and not negative.")
    return np.asarray(weights / np.maximum(weights.sum(axis=0), 1.0))


@dataclass(frozen=True)
class _Fit:
    """What the fits of all regions share."""

    rest: FloatArray
    points: FloatArray
    kernel: Kernel
    regularisation: float

    def region(
        self, share: FloatArray, columns: NDArray[np.intp], width: float | None, spacing_factor: float
    ) -> tuple[RegionFit, RegionMatrix]:
        """Fit a region, of which vertices have `share` (V,), on the control points `columns`."""
        if len(columns) == 0:
            raise HeadError(
                "A region has vertices but no control point. Bind its landmarks, or clear its vertex group."
            )
        centres = self.points[columns]
        between = distances(centres, centres)
        _refuse_coincident(between, columns)
        sigma = self.kernel.width(between, spacing_factor) if width is None else width
        rows = np.flatnonzero(share)
        system, condition = self._system(self.kernel.phi(between, sigma), f"at sigma {sigma:.3g}")

        def evaluation(part: NDArray[np.intp]) -> FloatArray:
            return self.kernel.phi(distances(self.rest[part], centres), sigma)

        return RegionFit(rows, columns, float(sigma), condition), _solved(system, evaluation, rows, columns, share)

    def surface(self, skin: SkinCovariance, share: FloatArray, columns: NDArray[np.intp]) -> RegionMatrix:
        """Fit `skin` on the control points `columns`, for the vertices that have `share` (V,) and that it joins."""
        rows = np.flatnonzero((share > 0.0) & skin.vertices.any(axis=1))
        system, _ = self._system(skin.control_points[np.ix_(columns, columns)], "on the skin")

        def evaluation(part: NDArray[np.intp]) -> FloatArray:
            return np.asarray(skin.vertices[part[:, None], columns], dtype=np.float64)

        return _solved(system, evaluation, rows, columns, share)

    def _system(self, phi: FloatArray, where: str) -> tuple[FloatArray, float]:
        """The regularised `phi`, and its condition number."""
        system = phi + self.regularisation * np.eye(len(phi))
        condition = float(np.linalg.cond(system))
        if not condition <= MAX_CONDITION:
            raise HeadError(
                f"The fit is ill-conditioned (condition number {condition:.1e} {where}). "
                "Lower sigma, or raise the regularisation."
            )
        return system, condition


def _solved(
    system: FloatArray,
    evaluation: Callable[[NDArray[np.intp]], FloatArray],
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    share: FloatArray,
) -> RegionMatrix:
    """The matrix of a fit for the vertices `rows`, whose kernel to the control points `evaluation` tells."""
    matrix = np.empty((len(rows), len(columns)), dtype=np.float32)
    for start in range(0, len(rows), _CHUNK):
        part = rows[start : start + _CHUNK]
        matrix[start : start + _CHUNK] = np.linalg.solve(system, evaluation(part).T).T * share[part, None]
    return RegionMatrix(rows, columns, matrix)


def _mean(regions: list[RegionMatrix], surface: RegionMatrix, count: int) -> list[RegionMatrix]:
    """The regions' functions and the process on the skin in shares; where the latter does not reach, the former."""
    kept = np.ones(count, dtype=np.float32)
    kept[surface.rows] -= _SKIN_SHARE
    halved = [RegionMatrix(r.rows, r.columns, r.matrix * kept[r.rows, None]) for r in regions]
    return [*halved, RegionMatrix(surface.rows, surface.columns, np.float32(_SKIN_SHARE) * surface.matrix)]


def _followed(region: RegionMatrix, follow: NDArray[np.float32]) -> RegionMatrix:
    """The region's matrix for the displacements of those control points alone that `follow` (P, P) starts from."""
    columns = np.flatnonzero(follow[region.columns].any(axis=0))
    return RegionMatrix(region.rows, columns, region.matrix @ follow[np.ix_(region.columns, columns)])


def _refuse_coincident(between: FloatArray, columns: NDArray[np.intp]) -> None:
    if len(columns) < 2:
        return
    nearest = np.where(np.eye(len(columns), dtype=bool), np.inf, between).min(axis=1)
    if nearest.min() < 1e-6 * between.max():
        pair = columns[np.argmin(nearest)]
        raise HeadError(f"Control point {pair} lies on another one. Bind the two to different vertices.")
