"""Parts that ride on the skin: lashes, brows, a beard, the wall of the mouth (method.md, section 5.10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..mesh.nearest import NearestPoints
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray

_NEIGHBOURS = 10
_BREADTH = 0.02
"""Distance, in outer-eye distances, by which the neighbourhood of a root is wider than its distance from the skin."""
_STIFFNESS = 1e-3
"""Share of its inertia by which a neighbourhood resists rotations that it does not determine, such as about a line."""
_RIM_STIFFNESS = 1.0
"""The same share at the rim of a lid, which is such a line, beside which the skin stretches: it would kink a line of
lashes."""


class Glue:
    """Moves points with the skin below them, as rigidly as a lash turns with its lid.

    Parameters
    ----------
    points : (N, 3) array
        Points at rest, in the frame and unit of the skin.
    roots : (N,) array of int
        Point at which each is rooted in the skin: for a lash, its end at the lid; itself for a point on the skin.
    skin : (U, 3) array
        Vertices of the skin at rest.
    sides : (U,) array of int
        Side of a slit for each vertex of the skin. A root is held by the nearest side only, so that an upper lash does
        not follow the lower lid.
    unit : float
        Outer-eye distance, in the unit of the skin.
    rims : (M,) array of int, optional
        Vertices of the skin on the rims of lids.
    at_rim : (N,) array of bool, optional
        Whether a point is held by `rims` alone; by default none is.

    Notes
    -----
    Let d_i be the displacements of the nearest vertices of the skin, r_i their positions relative to the weighted mean,
    and w_i weights. A point is rotated about the mean by the vector that fits best (equation 5.10),
    ``omega = (sum w_i (|r_i|^2 - r_i r_i^T))^-1 sum w_i r_i x d_i``, and moves with the mean. The length of omega is
    the sine of the angle, up to a right angle.
    """

    def __init__(
        self,
        points: FloatArray,
        roots: IntArray,
        skin: FloatArray,
        sides: IntArray,
        unit: float,
        rims: IntArray | None = None,
        at_rim: NDArray[np.bool_] | None = None,
    ) -> None:
        places, skin = np.asarray(points, dtype=np.float64), np.asarray(skin, dtype=np.float64)
        sides = np.asarray(sides)
        self._roots, first, self._places = np.unique(roots, return_index=True, return_inverse=True)
        at = places[self._roots]
        self._rows, weights = _neighbours(at, skin, sides, unit)
        rim = np.zeros(len(at), dtype=np.bool_) if at_rim is None else np.asarray(at_rim)[first]
        if rims is not None and rim.any():
            found, weights[rim] = _neighbours(at[rim], skin[rims], sides[rims], unit)
            self._rows[rim] = rims[found]
        near = skin[self._rows]
        # Equation 5.10 at rest: weighted mean of the neighbourhood, arms r_i from it, and sum w r r^T.
        middle = np.einsum("nk,nkc->nc", weights, near)
        arms = near - middle[:, None]
        squares = np.einsum("nk,nkc,nkd->ncd", weights, arms, arms)
        # Inertia sum w (|r|^2 - r r^T), with a share of its trace on the diagonal: the rotation about a line of
        # neighbours, which they do not determine, is then held at 0.
        size = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        stiffness = np.where(rim, _RIM_STIFFNESS, _STIFFNESS)[:, None, None]
        inertia = size - squares + stiffness * size + 1e-30 * np.eye(3)
        # From displacements d_i to omega, I^-1 w_i [r_i]x, and to the shift of the mean, w_i; one matrix a root does
        # both in a frame.
        turns = np.einsum("nab,nk,nkbc->nkac", linalg.inverses_of_three(inertia), weights, _cross(arms))
        shares = weights[..., None, None] * np.eye(3)
        moments = np.swapaxes(np.concatenate([shares, turns], axis=2), 1, 2)
        self._moments = moments.reshape(len(at), 6, -1).astype(np.float32)
        self._middle = middle[self._places].astype(np.float32)
        self._arms = (places - middle[self._places]).astype(np.float32)

    def tables(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the tables that `move` uses, for evaluation in another program.

        Returns
        -------
        points : (N, 4) float32
            Middle of the neighbourhood of each point, and the index of its root.
        roots : (R, K, 3, 4) float32
            For each neighbour of each root, the matrix from its displacement to the rotation vector; in the fourth
            column, the vertex of the skin, its weight, and 0.
        """
        roots = np.zeros((*self._rows.shape, 3, 4), dtype=np.float32)
        moments = self._moments.reshape(len(roots), 6, -1, 3)
        roots[..., :3] = np.swapaxes(moments[:, 3:], 1, 2)
        roots[..., 0, 3], roots[..., 1, 3] = self._rows, moments[:, 0, :, 0]
        return np.column_stack([self._middle, self._places]).astype(np.float32), roots

    def move(self, displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        """Move the points.

        Parameters
        ----------
        displacements : (U, 3) float32
            Displacements of the skin, in its frame and unit.

        Returns
        -------
        (N, 3) float32
            Positions of the moved points.
        """
        near = displacements.take(self._rows, axis=0).reshape(len(self._rows), -1)
        moved = np.einsum("nak,nk->na", self._moments, near)
        turns = _rotations(moved[:, 3:]).take(self._places, axis=0)
        shift = moved[:, :3].take(self._places, axis=0)
        return np.asarray(self._middle + shift + np.einsum("nab,nb->na", turns, self._arms))


def _neighbours(
    roots: FloatArray, skin: FloatArray, sides: IntArray, unit: float
) -> tuple[NDArray[np.intp], FloatArray]:
    """Find the vertices of the skin near each root and on its side, and their weights, which sum to 1, (R, K)."""
    count = min(4 * _NEIGHBOURS, len(skin))
    rows, squared = NearestPoints(skin).query(roots, count)
    distance = np.sqrt(np.maximum(squared, 0.0)).astype(np.float64)
    # Neighbours across the slit are sorted last and get weight 0; four times the number is sought, so that enough
    # remain.
    other = sides[rows] != sides[rows[:, :1]]
    order = np.argsort(np.where(other, np.inf, distance), axis=1, kind="stable")[:, :_NEIGHBOURS]
    rows, distance = np.take_along_axis(rows, order, axis=1), np.take_along_axis(distance, order, axis=1)
    breadth = distance[:, :1] + _BREADTH * unit
    weights = np.exp(-np.square(distance / breadth)) * ~np.take_along_axis(other, order, axis=1)
    return rows, weights / weights.sum(axis=1, keepdims=True)


def _cross(arms: FloatArray) -> FloatArray:
    """Matrices [r]x with ``[r]x d = r x d``, (..., 3, 3)."""
    x, y, z = np.moveaxis(arms, -1, 0)
    zero = np.zeros_like(x)
    return np.asarray(np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3))


def _rotations(turns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Matrices (R, 3, 3) of the rotation vectors `turns`, whose length is the sine of the angle (Rodrigues)."""
    length = np.linalg.norm(turns, axis=1)[:, None, None]
    sine = np.minimum(length, np.float32(1.0))
    axis = turns / np.maximum(length[..., 0], np.float32(1e-12))
    cosine = np.sqrt(1.0 - np.square(sine))
    # R = a a^T + cos (1 - a a^T) + sin [a]x.
    along = axis[:, :, None] * axis[:, None]
    return np.asarray(along + cosine * (np.eye(3, dtype=np.float32) - along) + sine * _cross(axis), dtype=np.float32)
