"""Triangles of a mesh: which pass through each other, and which are seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray, IntArray

_PAIRS_AT_ONCE = 200_000
"""Pairs of triangles that are tested at a time, which limits memory."""
_PARALLEL = 1e-12
"""Triple product of an edge and two sides of a triangle, over their lengths, below which the edge counts as
parallel."""
_INSIDE = 1e-9
"""Share of a triangle or an edge by which they must meet inside it, so that triangles that only touch do not cross."""


def crossing_pairs(
    vertices: FloatArray, triangles: IntArray, moved: NDArray[np.bool_] | None = None
) -> NDArray[np.intp]:
    """Find the pairs of triangles (P, 2) that pass through each other.

    They have no common vertex, and an edge of one goes through the other (Moeller & Trumbore 1997). Triangles that lie
    in one plane, or only touch, do not count. At least one triangle of a pair is `moved` (T,); by default all are.
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
        for a, b in (pairs[start : start + _PAIRS_AT_ONCE].T for start in range(0, len(pairs), _PAIRS_AT_ONCE))
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
        stop = max(start + 1, int(np.searchsorted(total, total[start] + _PAIRS_AT_ONCE, side="right")) - 1)
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


_FRAGMENTS_AT_ONCE = 1 << 20
"""Pixels tested at a time, which limits memory."""
_BUDGET = 1 << 24
"""Pixels tested in total, which limits time: beyond that, the largest triangles are left out."""


@dataclass(frozen=True)
class Fragments:
    """The nearest surface at each covered pixel.

    Attributes
    ----------
    pixel : (F,) intp
        Row-major pixel index.
    triangle : (F,) intp
        Index of the triangle that is seen there.
    barycentric : (F, 3) float32
        Barycentric coordinates of the pixel in that triangle.
    depth : (H, W) float32
        Depth of the nearest surface at all pixels; infinite where nothing was drawn.
    """

    pixel: NDArray[np.intp]
    triangle: NDArray[np.intp]
    barycentric: NDArray[np.float32]
    depth: NDArray[np.float32]


def rasterise(points: FloatArray, depth: FloatArray, triangles: IntArray, size: int) -> Fragments:
    """Draw triangles into a square image, `size` pixels wide, with a z-buffer.

    Points (V, 2) are in pixels, whose centres have integer coordinates, and smaller depths (V,) hide larger ones. Both
    sides are drawn, so the caller leaves out triangles that face away.
    """
    corners = points[triangles].astype(np.float32)
    nearness = depth[triangles].astype(np.float32)
    owner = np.full(size * size, -1, np.intp)
    shares = np.zeros((size * size, 3), np.float32)
    buffer = np.full(size * size, np.inf, np.float32)
    for chosen, low, side in _groups(corners, size):
        pixel, triangle, weights, z = _candidates(corners, nearness, chosen, low, side, size)
        # Sorted by pixel and depth, the first of each pixel is its nearest candidate; it wins if it is nearer than what
        # earlier groups drew there.
        order = np.lexsort((z, pixel))
        order = order[np.diff(pixel[order], prepend=-1) > 0]
        order = order[z[order] < buffer[pixel[order]]]
        seen = pixel[order]
        owner[seen], shares[seen], buffer[seen] = triangle[order], weights[order], z[order]
    covered = np.flatnonzero(owner >= 0)
    return Fragments(covered, owner[covered], shares[covered], buffer.reshape(size, size))


def _groups(corners: FloatArray, size: int) -> Iterator[tuple[NDArray[np.intp], IntArray, int]]:
    """Yield triangles with bounding boxes of about equal size, the first pixels of these boxes, and their side.

    All pixels of a group's boxes are tested at once, and similar sizes keep the waste below the area that is covered.
    """
    low = np.clip(np.ceil(corners.min(axis=1)), 0, size).astype(np.intp)
    high = np.clip(np.floor(corners.max(axis=1)), -1, size - 1).astype(np.intp)
    extent = high - low + 1
    inside = (extent > 0).all(axis=1)
    # A triangle of level k fits into a box of 2^k pixels a side.
    level = np.ceil(np.log2(np.maximum(extent.max(axis=1), 1))).astype(int)
    left = _BUDGET
    for k in np.unique(level[inside]).tolist():
        chosen = np.flatnonzero(inside & (level == k))[: left >> 2 * k]
        left -= len(chosen) << 2 * k
        step = max(_FRAGMENTS_AT_ONCE >> 2 * k, 1)
        for start in range(0, len(chosen), step):
            part = chosen[start : start + step]
            yield part, low[part], 1 << k


def _candidates(
    corners: FloatArray, nearness: FloatArray, chosen: NDArray[np.intp], low: IntArray, side: int, size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Pixels inside the chosen triangles, as index, triangle, barycentric coordinates and depth."""
    a, b, c = (corners[chosen, i] for i in range(3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    area = np.where(np.abs(area) < 1e-9, np.float32(1e-9), area)[:, None]
    down, across = np.divmod(np.arange(side * side), side)
    x, y = low[:, :1] + across, low[:, 1:] + down
    px, py = x.astype(np.float32) - a[:, :1], y.astype(np.float32) - a[:, 1:]
    # Barycentric coordinates by Cramer's rule: p - a = wb u + wc v.
    wb, wc = (px * v[:, 1:] - py * v[:, :1]) / area, (u[:, :1] * py - u[:, 1:] * px) / area
    wa = 1.0 - wb - wc
    row, col = np.nonzero((wa >= 0) & (wb >= 0) & (wc >= 0) & (x < size) & (y < size))
    weights = np.column_stack([w[row, col] for w in (wa, wb, wc)]).astype(np.float32)
    triangle = chosen[row]
    z = (weights * nearness[triangle]).sum(axis=1).astype(np.float32)
    return y[row, col] * size + x[row, col], triangle, weights, z
