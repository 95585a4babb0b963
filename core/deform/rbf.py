"""Radial basis functions, one per region, prepared so that a frame is one matrix product (method.md, section 5.1).

The paper refits the weights in every frame. As rest positions do not change, neither does the matrix of the fit, so it
is inverted once and multiplied by the evaluation at every vertex. Gaussians become ill-conditioned with growing sigma;
a fit is refused before rounding errors become visible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DataError, HeadError, Message
from ..mesh.kernels import Kernel, distances, get_kernel
from ..numeric import linalg
from ..numeric.arrays import FloatArray, as_points
from .blocks import BlockProduct, RegionMatrix, RowBuilder
from .covariance import REGULARISATION, SkinCovariance
from .lid_rims import LidRims

MAX_CONDITION = 1e10
"""Largest condition number of a fit, beyond which rounding errors would be visible."""
_SKIN_SHARE = 0.6
"""Share of the process on the skin in its mean with the regions' functions (section 5.6)."""
_CHUNK = 4_000
"""Number of vertices fitted at a time, which fit into the CPU's second-level cache."""


@dataclass(frozen=True)
class RegionFit:
    """Properties of the fit of a region.

    Attributes
    ----------
    rows : (Vr,) intp
        Vertices that the region moves.
    columns : (Pr,) intp
        Control points that move them.
    sigma : float
        Width of the kernel, in the unit of the vertices.
    condition : float
        Condition number of the regularised kernel matrix.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    sigma: float
    condition: float


class RBFDeformer:
    """Deforms a mesh by the displacements of its control points.

    The control points of each region have to be distinct, and sigma must not be far above their spacing.

    Parameters
    ----------
    vertices : (V, 3) array_like
        Rest positions, in any frame and unit.
    control_points : (P, 3) array_like
        Rest positions of the control points, in the same frame.
    region_weights : (R, V) array_like
        Weight of each region at each vertex, at least 0, normalised where the sum exceeds one. Vertices take the
        weighted mean of overlapping regions (for weights of 0 and 1, the paper's mean), and move less where weights
        fade out.
    membership : (R, P) array_like of bool
        Whether a control point belongs to a region.
    kernel : str
        Key in `KERNELS`; by default the paper's Gaussian.
    sigma : float or (R,) array_like, optional
        Width of the kernel, for all regions or for each; by default the spacing of the region's control points times
        `spacing_factor`.
    spacing_factor : float or (R,) array_like
        Factor of the default width, for all regions or for each.
    regularisation : float
        Added to the diagonal of the kernel matrix, whose entries are at most one. With 0.001 the skin between control
        points is smoother than with 0, and the points are met within 0.5 mm.
    skin : SkinCovariance, optional
        A process on the surface of the mesh, for all control points. Vertices that it joins to any of them take a
        weighted mean of it and the regions' functions.
    follow : (P, P) array_like, optional
        Matrix from given displacements to those of all control points, as returned by `follow_matrix`. Columns of
        points that are not given are 0. By default all points are given.
    rims : sequence of LidRims
        Rims of lids that meet when their landmarks do; the control points have to be the 66 landmarks.

    Attributes
    ----------
    rest : (V, 3) float32
        Rest positions.
    fits : tuple of RegionFit
        Fits of the regions that have vertices.
    nbytes : int
        Memory of the matrices in bytes.

    Raises
    ------
    HeadError
        If control points coincide, a region has vertices but no control points, or the fit is ill-conditioned.

    Notes
    -----
    Equations 5.1 and 5.2 (Yao et al. 2019, equations 1 to 3). Preparation costs O(R P^3 + V P). A frame costs V P
    multiply-adds per coordinate, where P counts the control points of a vertex's regions. An instance contains the
    buffers of a frame, so each thread needs its own.

    Examples
    --------
    The paper's interpolation, whose control points belong to the upper, the middle or the lower region:

    >>> from facemime import REGIONS, RBFDeformer, built_in_head
    >>> head = built_in_head()
    >>> points = head.vertices[head.landmarks]
    >>> members = [np.isin(np.arange(66), region.landmarks) for region in REGIONS]
    >>> deformer = RBFDeformer(head.vertices, points, head.region_weights, members, regularisation=0.0)
    >>> moved = deformer.deform(0.001 * np.random.default_rng(0).standard_normal((66, 3)))
    >>> moved.shape
    (1781, 3)
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
        regularisation: float = REGULARISATION,
        skin: SkinCovariance | None = None,
        follow: ArrayLike | None = None,
        rims: Sequence[LidRims] = (),
    ) -> None:
        rest = as_points(vertices, "vertices", error=HeadError)
        points = as_points(control_points, "control_points", error=HeadError)
        members = np.asarray(membership, dtype=np.bool_)
        shares = _normalise_weights(region_weights, len(members), len(rest))
        if members.shape != (len(shares), len(points)):
            raise HeadError(
                "membership must be ({shares}, {points}); got {shape}.",
                shares=len(shares),
                points=len(points),
                shape=members.shape,
            )
        factors = np.broadcast_to(np.asarray(spacing_factor, dtype=np.float64), len(members))
        if sigma is not None and not (np.asarray(sigma) > 0).all():
            raise HeadError("sigma must be positive; got {sigma!r}.", sigma=sigma)
        widths = [None] * len(members) if sigma is None else np.broadcast_to(np.asarray(sigma), len(members)).tolist()
        fit = _Fit(rest, points, get_kernel(kernel), regularisation)
        # Mean of the regions' functions (equation 5.2) with the process on the skin (5.6), where it reaches.
        total = shares.sum(axis=0)
        joined = np.zeros(len(rest), dtype=np.bool_) if skin is None else skin.joined & (total > 0.0)
        scale = np.where(joined, 1.0 - _SKIN_SHARE, 1.0)
        regions = [
            fit.region(shares[row] * scale, np.flatnonzero(members[row]), widths[row], float(factors[row]))
            for row in range(len(members))
            if shares[row].any()
        ]
        if not regions:
            raise HeadError("No vertex lies in a region. Paint the regions Upper, Middle and Lower as vertex groups.")
        matrices = [matrix for _, matrix in regions]
        if skin is not None:
            used = np.flatnonzero(members[shares.any(axis=1)].any(axis=0))
            matrices.append(fit.surface(skin, np.where(joined, _SKIN_SHARE * total, 0.0), used))
        # Lids meet along their whole rims (5.8).
        if rims:
            rows = RowBuilder(matrices, len(rest), len(points))
            matrices += [rim.correction(rows) for rim in rims]
        # Landmarks that are not control points follow those that are (6.1).
        if follow is not None:
            matrices = [_apply_follow(matrix, np.asarray(follow, dtype=np.float32)) for matrix in matrices]
        self.rest: NDArray[np.float32] = rest.astype(np.float32)
        self.n_control_points = len(points)
        self.fits = tuple(found for found, _ in regions)
        self._product = BlockProduct(self.rest, matrices, len(points))
        self.nbytes = self._product.nbytes

    def deform(self, displacements: ArrayLike, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Deform the mesh.

        Parameters
        ----------
        displacements : (P, 3) array_like
            Displacements of the control points from rest, in the frame and unit of `vertices`.
        out : (V, 3) float32, optional
            C-contiguous array for the result.

        Returns
        -------
        (V, 3) float32
            The deformed vertices; `out` if given.
        """
        moved = np.asarray(displacements, dtype=np.float32)
        if moved.shape != (self.n_control_points, 3) or not math.isfinite(np.vdot(moved, moved)):
            as_points(displacements, "displacements", count=self.n_control_points)
        result = np.empty_like(self.rest) if out is None else out
        if result.shape != self.rest.shape or result.dtype != np.float32 or not result.flags.c_contiguous:
            raise DataError("out must be {shape}, float32 and C-contiguous", shape=self.rest.shape)
        self._product.apply(moved, result)
        return result

    def matrix(self) -> NDArray[np.float32]:
        """Return the whole matrix A of ``rest + A d``, (V, P), for analysis; frames do not need it."""
        columns = []
        unit = np.zeros((self.n_control_points, 3), dtype=np.float32)
        for column in range(self.n_control_points):
            unit[column, 0] = 1.0
            columns.append((self.deform(unit) - self.rest)[:, 0])
            unit[column, 0] = 0.0
        return np.stack(columns, axis=1)


class IncrementalDeformer:
    """The paper's method (its section 3.2), which fits each frame to the coordinates of the previous one.

    It is about fifty times slower than `RBFDeformer`, and the result depends on all frames since `reset`.

    Parameters
    ----------
    vertices, control_points, region_weights, membership, **options
        As for `RBFDeformer`, without `skin`.

    Raises
    ------
    HeadError
        As for `RBFDeformer`, at rest.

    Notes
    -----
    With coordinates x' and control points c' of the previous frame, ``x = x' + sum_j w_j phi(|x' - c'_j|)``, where the
    weights fit the steps of the control points (equations 1 to 3). Moving points may come close to one another;
    singular values below 1e-10 of the largest are left out, so that no frame is refused.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        control_points: ArrayLike,
        region_weights: ArrayLike,
        membership: ArrayLike,
        **options: Any,
    ) -> None:
        at_rest = RBFDeformer(vertices, control_points, region_weights, membership, **options)
        self.rest = at_rest.rest
        self.n_control_points = at_rest.n_control_points
        self.fits = at_rest.fits
        self._points = as_points(control_points, "control_points", error=HeadError)
        shares = _normalise_weights(region_weights, len(np.asarray(membership)), len(self.rest))
        self._shares = shares[shares.any(axis=1)]
        self._kernel = get_kernel(options.get("kernel", "gaussian"))
        self._ridge = float(options.get("regularisation", REGULARISATION))
        self._follow = None if options.get("follow") is None else np.asarray(options["follow"], dtype=np.float64)
        self.reset()

    def reset(self) -> None:
        """Start again from rest."""
        self._vertices = self.rest.astype(np.float64)
        self._moved = np.zeros_like(self._points)

    def deform(self, displacements: ArrayLike, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Deform the mesh from the coordinates of the previous frame, and return the vertices (V, 3); `out` if given.

        They depend on all frames since `reset`; displacements are as for `RBFDeformer.deform`.
        """
        moved = as_points(displacements, "displacements", count=self.n_control_points)
        if self._follow is not None:
            moved = self._follow @ moved
        before, after = self._vertices, self._vertices.copy()
        for fit, share in zip(self.fits, self._shares, strict=True):
            centres = self._points[fit.columns] + self._moved[fit.columns]
            system = self._kernel.phi(distances(centres, centres), fit.sigma) + self._ridge * np.eye(len(centres))
            step = moved[fit.columns] - self._moved[fit.columns]
            weights = linalg.lstsq(system, step, cond=1.0 / MAX_CONDITION)[0]
            reach = self._kernel.phi(distances(before[fit.rows], centres), fit.sigma)
            after[fit.rows] += share[fit.rows, None] * (reach @ weights)
        self._vertices, self._moved = after, np.asarray(moved)
        result = np.empty_like(self.rest) if out is None else out
        result[...] = after
        return result


def _normalise_weights(region_weights: ArrayLike, n_regions: int, n_vertices: int) -> FloatArray:
    weights = np.asarray(region_weights, dtype=np.float64)
    if weights.shape != (n_regions, n_vertices):
        raise HeadError(
            "region_weights must be ({n_regions}, {n_vertices}); got {shape}.",
            n_regions=n_regions,
            n_vertices=n_vertices,
            shape=weights.shape,
        )
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise HeadError("region_weights must be finite and not negative.")
    return np.asarray(weights / np.maximum(weights.sum(axis=0), 1.0))


@dataclass(frozen=True)
class _Fit:
    """Parameters that the fits of all regions share."""

    rest: FloatArray
    points: FloatArray
    kernel: Kernel
    regularisation: float

    def region(
        self, share: FloatArray, columns: NDArray[np.intp], width: float | None, spacing_factor: float
    ) -> tuple[RegionFit, RegionMatrix]:
        """Fit a region with the weights `share` (V,) to the control points `columns`."""
        if len(columns) == 0:
            raise HeadError(
                "A region has vertices but no control points. Bind its landmarks, or clear its vertex group."
            )
        centres = self.points[columns]
        between = distances(centres, centres)
        _check_distinct(between, columns)
        sigma = self.kernel.width(between, spacing_factor) if width is None else width
        rows = np.flatnonzero(share)
        system, condition = self._system(self.kernel.phi(between, sigma), Message("at sigma {sigma:.3g}", sigma=sigma))

        def evaluation(part: NDArray[np.intp]) -> FloatArray:
            return self.kernel.phi(distances(self.rest[part], centres), sigma)

        return RegionFit(rows, columns, float(sigma), condition), _solve(system, evaluation, rows, columns, share)

    def surface(self, skin: SkinCovariance, share: FloatArray, columns: NDArray[np.intp]) -> RegionMatrix:
        """Fit `skin` to the control points `columns`, for vertices with `share` (V,)."""
        system, _ = self._system(skin.control_points[np.ix_(columns, columns)], Message("on the skin"))

        def evaluation(part: NDArray[np.intp]) -> FloatArray:
            return np.asarray(skin.vertices[part][:, columns], dtype=np.float64)

        return _solve(system, evaluation, np.flatnonzero(share), columns, share)

    def _system(self, phi: FloatArray, where: str) -> tuple[FloatArray, float]:
        """Return the regularised kernel matrix and its condition number."""
        system = phi + self.regularisation * np.eye(len(phi))
        values = linalg.svdvals(system)
        condition = float(values[0] / values[-1]) if values[-1] > 0.0 else math.inf
        if not condition <= MAX_CONDITION:
            raise HeadError(
                "The fit is ill-conditioned (condition number {condition:.1e} {where}). "
                "Turn off Exact Fit, lower sigma, or raise the regularisation.",
                condition=condition,
                where=where,
            )
        return system, condition


def _solve(
    system: FloatArray,
    evaluation: Callable[[NDArray[np.intp]], FloatArray],
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    share: FloatArray,
) -> RegionMatrix:
    """Compute the matrix of a fit for the vertices `rows`; `evaluation` returns the kernel from them to its points."""
    matrix = np.empty((len(rows), len(columns)), dtype=np.float32)
    # A product with the inverse is much faster than solving, and accurate, as `MAX_CONDITION` limits the condition.
    inverse = linalg.inv(system)
    for start in range(0, len(rows), _CHUNK):
        part = rows[start : start + _CHUNK]
        matrix[start : start + _CHUNK] = linalg.multiply(evaluation(part), inverse) * share[part, None]
    return RegionMatrix(rows, columns, matrix)


def _apply_follow(region: RegionMatrix, follow: NDArray[np.float32]) -> RegionMatrix:
    """Multiply the matrix of a region by `follow` (P, P), so that it applies to the given control points alone."""
    columns = np.flatnonzero(follow[region.columns].any(axis=0))
    return RegionMatrix(region.rows, columns, region.matrix @ follow[np.ix_(region.columns, columns)])


def _check_distinct(between: FloatArray, columns: NDArray[np.intp]) -> None:
    if len(columns) < 2:
        return
    nearest = np.where(np.eye(len(columns), dtype=bool), np.inf, between).min(axis=1)
    if nearest.min() < 1e-6 * between.max():
        pair = columns[np.argmin(nearest)]
        raise HeadError("Control point {pair} coincides with another one. Bind them to different vertices.", pair=pair)
