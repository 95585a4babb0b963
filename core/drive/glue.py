"""Points that ride on the skin, as lashes, brows and beards do (method.md, section 5.10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..mesh.surface import NearestPoints, triangulate
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray

_NEIGHBOURS = 10
_BENEATH = 0.1
"""Distance from the skin, in outer-eye distances, within which a root shifts with the triangle beneath it."""
_AROUND = 4
"""Number of nearest vertices whose triangles are tried."""
_BREADTH = 0.02
"""Distance, in outer-eye distances, by which the neighbourhood of a root is wider than its distance from the skin."""
_STIFFNESS = 1e-3
"""Share of its inertia by which a neighbourhood resists rotations that it does not determine, such as about a line."""
_RIM_STIFFNESS = 1.0
"""The same share at the rim of a lid, which is such a line, beside which the skin stretches: it would kink a line of
lashes."""

_POSITIVE, _NEGATIVE = np.array([7, 2, 3]), np.array([5, 6, 1])
"""Where x, y and z are in [r]x, row by row, and where their negatives are."""


@dataclass(frozen=True)
class Roots:
    """What holds each of N points that ride on the skin.

    Attributes
    ----------
    at : (N,) intp
        The point at which each is rooted in the skin: for a lash, its end at the lid; itself for a point on the skin.
    at_rim : (N,) bool
        Whether the root is held only by the rims of lids.
    walls : (N,) bool
        Whether the point is shifted, but not rotated.
    sides : (N,) intp
        Side of a slit on which the root is held; -1 for that of the nearest vertex of the skin.
    """

    at: NDArray[np.intp]
    at_rim: NDArray[np.bool_]
    walls: NDArray[np.bool_]
    sides: NDArray[np.intp]

    @classmethod
    def by_nearest(cls, at: IntArray) -> Roots:
        """Roots at the points `at` (N,), which are held by the skin nearest to them."""
        no = np.zeros(len(at), dtype=np.bool_)
        return cls(np.array(at), no, no.copy(), np.full(len(at), -1))


class Glue:
    """Moves points (N, 3) with the skin (U, 3) below them, as rigidly as a lash turns with its lid.

    `sides` (U,) says on which side of a slit each vertex of the skin is: a root is held by one side only, so that an
    upper lash does not follow the lower lid. `rims` (M,) are the vertices of the skin on the rims of lids. Points and
    skin are at rest, in one frame and unit, and `unit` is the outer-eye distance in it. A root close to the `faces`
    (F, K) of the skin shifts with the triangle beneath it: on a coarse skin, which bends at its vertices, brows would
    otherwise come to lie below it here and there.

    Let d_i be the displacements of the nearest vertices of the skin, r_i their positions relative to the weighted mean,
    and w_i weights. A point is rotated about the mean by the vector that fits best (equation 5.10),
    ``omega = (sum w_i (|r_i|^2 - r_i r_i^T))^-1 sum w_i r_i x d_i``, and moves with the mean. The length of omega is
    the sine of the angle, up to a right angle.
    """

    def __init__(
        self,
        points: FloatArray,
        roots: Roots,
        skin: FloatArray,
        sides: IntArray,
        unit: float,
        rims: IntArray | None = None,
        faces: IntArray | None = None,
    ) -> None:
        places, skin = np.asarray(points, dtype=np.float64), np.asarray(skin, dtype=np.float64)
        sides = np.asarray(sides)
        self._roots, first, self._places = np.unique(roots.at, return_index=True, return_inverse=True)
        at, rim = places[self._roots], roots.at_rim[first]
        self._rows, weights = _neighbours(at, skin, sides, unit, roots.sides[first])
        if rims is not None and rim.any():
            found, weights[rim] = _neighbours(at[rim], skin[rims], sides[rims], unit, roots.sides[first][rim])
            self._rows[rim] = rims[found]
        held = weights
        if faces is not None:
            free = ~rim & ~roots.walls[first] & (roots.sides[first] < 0)
            corners, shares, away = nearest_triangles(at, skin, triangulate(faces))
            free &= away < _BENEATH * unit
            self._rows = np.concatenate([self._rows, corners], axis=1)
            beneath = np.pad(shares, ((0, 0), (weights.shape[1], 0)))
            weights = np.pad(weights, ((0, 0), (0, 3)))
            held = np.where(free[:, None], beneath, weights)
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
        turns[roots.walls[first]] = 0.0
        shifts = held[..., None, None] * np.eye(3)
        moments = np.swapaxes(np.concatenate([shifts, turns], axis=2), 1, 2)
        self._moments = moments.reshape(len(at), 6, -1).astype(np.float32)
        middle = np.einsum("nk,nkc->nc", held, near)  # what is shifted by these weights
        self._middle = middle[self._places].astype(np.float32)
        self._arms = (places - middle[self._places]).astype(np.float32)

    def tables(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the tables that `move` uses, for evaluation in another program.

        The first, (N, 4), holds the middle of the neighbourhood of each point, and the index of its root. The second,
        (R, K, 3, 4), holds, for each neighbour of each root, the matrix from its displacement to the rotation vector;
        in the fourth column, the vertex of the skin, its weight, and 0.
        """
        roots = np.zeros((*self._rows.shape, 3, 4), dtype=np.float32)
        moments = self._moments.reshape(len(roots), 6, -1, 3)
        roots[..., :3] = np.swapaxes(moments[:, 3:], 1, 2)
        roots[..., 0, 3], roots[..., 1, 3] = self._rows, moments[:, 0, :, 0]
        return np.column_stack([self._middle, self._places]).astype(np.float32), roots

    def move(self, displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the moved points (..., N, 3), for displacements (..., U, 3) of the skin in its frame and unit."""
        near = displacements.take(self._rows, axis=-2)
        moved = np.einsum("nak,...nk->...na", self._moments, near.reshape(*near.shape[:-2], -1))
        turns = _rotations(moved[..., 3:]).take(self._places, axis=-3)
        shift = moved[..., :3].take(self._places, axis=-2)
        return np.asarray(self._middle + shift + np.einsum("...nab,nb->...na", turns, self._arms))


def _neighbours(
    roots: FloatArray, skin: FloatArray, sides: IntArray, unit: float, own: IntArray
) -> tuple[NDArray[np.intp], FloatArray]:
    """Find the vertices of the skin near each root and on its side, and their weights, which sum to 1, (R, K).

    The side is `own` (R,), or that of the nearest vertex if that is -1, or far away.
    """
    count = min(4 * _NEIGHBOURS, len(skin))
    rows, squared = NearestPoints(skin).query(roots, count)
    distance = np.sqrt(np.maximum(squared, 0.0)).astype(np.float64)
    side = np.where((sides[rows] == own[:, None]).any(axis=1), own, sides[rows[:, 0]])
    # Neighbours across the slit are sorted last and get weight 0; four times the number is sought, so that enough
    # remain.
    other = sides[rows] != side[:, None]
    order = np.argsort(np.where(other, np.inf, distance), axis=1, kind="stable")[:, :_NEIGHBOURS]
    rows, distance = np.take_along_axis(rows, order, axis=1), np.take_along_axis(distance, order, axis=1)
    breadth = distance[:, :1] + _BREADTH * unit
    weights = np.exp(-np.square(distance / breadth)) * ~np.take_along_axis(other, order, axis=1)
    return rows, weights / weights.sum(axis=1, keepdims=True)


def nearest_triangles(
    points: FloatArray, vertices: FloatArray, triangles: IntArray
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Find the triangle (T, 3) at one of the nearest vertices (V, 3) that is nearest to each of points (N, 3).

    Returns its corners (N, 3), the weights (N, 3) of the place that is nearest, 0 to 1, and the distance from there,
    (N,).
    """
    order = np.argsort(triangles.ravel(), kind="stable") // 3
    ends = np.cumsum(np.bincount(triangles.ravel(), minlength=len(vertices)))
    near, _ = NearestPoints(vertices).query(points, min(_AROUND, len(vertices)))
    first, count = np.append(0, ends)[near], np.bincount(triangles.ravel(), minlength=len(vertices))[near]
    # Candidates (N, C): the triangles of all near vertices; the last one stands for those that are missing.
    steps = np.arange(int(count.max(initial=1)))
    tried = order[np.minimum(first[..., None] + steps, len(order) - 1)].reshape(len(points), -1)
    missing = (steps >= count[..., None]).reshape(len(points), -1)
    corners = vertices[triangles[tried]]
    origin, one, two = corners[:, :, 0], corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    off = points[:, None] - origin
    (a, b, c), (d, e) = (
        [(left * right).sum(axis=2) for left, right in pairs]
        for pairs in (((one, one), (one, two), (two, two)), ((off, one), (off, two)))
    )
    area = np.maximum(a * c - b * b, 1e-30)
    shares = np.stack([area - (c * d - b * e) - (a * e - b * d), c * d - b * e, a * e - b * d], axis=2)
    shares = np.maximum(shares / area[..., None], 0.0)
    shares /= shares.sum(axis=2, keepdims=True)
    away = np.linalg.norm((shares[..., None] * corners).sum(axis=2) - points[:, None], axis=2)
    best = np.where(missing, np.inf, away).argmin(axis=1)
    rows = np.arange(len(points))
    return triangles[tried[rows, best]], shares[rows, best], away[rows, best]


def _cross(arms: FloatArray) -> FloatArray:
    """Matrices [r]x with ``[r]x d = r x d``, (..., 3, 3)."""
    x, y, z = np.moveaxis(arms, -1, 0)
    zero = np.zeros_like(x)
    return np.asarray(np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3))


def _rotations(turns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Matrices (R, 3, 3) of the rotation vectors `turns`, whose length is the sine of the angle (Rodrigues)."""
    length = np.sqrt(np.einsum("nc,nc->n", turns, turns))[:, None]
    sine = np.minimum(length, np.float32(1.0))
    axis = turns / np.maximum(length, np.float32(1e-12))
    cosine = np.sqrt(1.0 - np.square(sine))
    # R = (1 - cos) a a^T + cos 1 + sin [a]x.
    rotations = ((1.0 - cosine) * axis)[:, :, None] * axis[:, None]
    entries, axis = rotations.reshape(len(turns), 9), sine * axis
    entries[:, ::4] += cosine
    entries[:, _POSITIVE] += axis
    entries[:, _NEGATIVE] -= axis
    return np.asarray(rotations, dtype=np.float32)
