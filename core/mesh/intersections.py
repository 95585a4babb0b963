"""Triangles of a mesh that pass through each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray, IntArray

_CHUNK = 200_000
"""Pairs of triangles that are tested at a time, which limits memory."""
_PARALLEL = 1e-12
"""Triple product of an edge and two sides of a triangle, over their lengths, below which the edge counts as
parallel."""
_INSIDE = 1e-9
"""Share of a triangle or an edge by which they must meet inside it, so that triangles that only touch do not cross."""


def crossing_pairs(
    vertices: FloatArray, triangles: IntArray, moved: NDArray[np.bool_] | None = None
) -> NDArray[np.intp]:
    """Find the pairs of triangles that pass through each other.

    Parameters
    ----------
    vertices : (V, 3) array
        Any frame and unit.
    triangles : (T, 3) array of int
        Vertices of each triangle.
    moved : (T,) bool, optional
        Triangles of which each pair must contain at least one; by default all.

    Returns
    -------
    (P, 2) int
        Pairs of triangles without a common vertex, of which one has an edge that goes through the other (Moeller &
        Trumbore 1997). Triangles that lie in one plane, or only touch, do not count.
    """
    triangles = np.asarray(triangles, dtype=np.intp)
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    pairs = _near(corners)
    if moved is not None:
        pairs = pairs[moved[pairs].any(axis=1)]
    own, other = triangles[pairs[:, 0]], triangles[pairs[:, 1]]
    pairs = pairs[~(own[:, :, None] == other[:, None, :]).any(axis=(1, 2))]
    crossing = [
        _pierces(corners[a], corners[b]) | _pierces(corners[b], corners[a])
        for a, b in (pairs[start : start + _CHUNK].T for start in range(0, len(pairs), _CHUNK))
    ]
    return np.asarray(pairs[np.concatenate([np.zeros(0, dtype=bool), *crossing])], dtype=np.intp)


def _near(corners: FloatArray) -> NDArray[np.intp]:
    """Pairs of triangles with corners (T, 3, 3) whose bounding boxes overlap, (P, 2), that with the smaller x first."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    # Sorted by x, the boxes that begin before a given one ends follow it directly.
    ends = np.searchsorted(low[:, 0], high[:, 0], side="right")
    counts = np.maximum(ends - np.arange(len(ends)) - 1, 0)
    found = [np.empty((0, 2), dtype=np.intp)]
    total = np.concatenate([[0], np.cumsum(counts)])
    start = 0
    while start < len(counts):
        stop = max(start + 1, int(np.searchsorted(total, total[start] + _CHUNK, side="right")) - 1)
        first = np.repeat(np.arange(start, stop), counts[start:stop])
        second = first + 1 + np.arange(len(first)) - (total[first] - total[start])
        near = ((low[first, 1:] <= high[second, 1:]) & (low[second, 1:] <= high[first, 1:])).all(axis=1)
        found.append(np.column_stack([order[first[near]], order[second[near]]]))
        start = stop
    return np.concatenate(found)


def _pierces(edges_of: FloatArray, triangles: FloatArray) -> NDArray[np.bool_]:
    """Whether an edge of each triangle of `edges_of` (P, 3, 3) goes through the other triangle (P, 3, 3), (P,)."""
    corner, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    through = np.zeros(len(triangles), dtype=bool)
    for k in range(3):
        begin, along = edges_of[:, k], edges_of[:, (k + 1) % 3] - edges_of[:, k]
        # Solves begin + share along = corner + first u + second v by Cramer's rule, whose determinants are triple
        # products; that of the system, u . (along x v), is 0 if the edge is parallel to the triangle.
        across = np.cross(along, v)
        volume = (u * across).sum(axis=1)
        size = np.linalg.norm(along, axis=1) * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
        crossed = np.abs(volume) > _PARALLEL * size
        volume = np.where(crossed, volume, 1.0)
        away = begin - corner
        first = (away * across).sum(axis=1) / volume
        turned = np.cross(away, u)
        second = (along * turned).sum(axis=1) / volume
        share = (v * turned).sum(axis=1) / volume
        inside = (first > _INSIDE) & (second > _INSIDE) & (first + second < 1.0 - _INSIDE)
        through |= crossed & inside & (share > _INSIDE) & (share < 1.0 - _INSIDE)
    return through
