"""Ribbons: flat, tapering strips that stand for locks of hair, hairs of a brow and lashes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A mesh: `vertices` (n, 3), `faces` (f, 4) padded with -1, `uv` (f, 4, 2)."""

    vertices: Points
    faces: NDArray[np.int64]
    uv: NDArray[np.float64]


def ribbons(paths: Points, across: Points, columns: Points) -> Shape:
    """Strips along `paths` (N, K, 3), from root to tip, where they end in a point.

    `across` (N, K, 3) leads from the middle to an edge; `columns` (N, 2) are the left and right u of each strip.
    """
    count, length = paths.shape[:2]
    edges = np.stack([paths - across, paths + across], axis=2)[:, :-1].reshape(count, -1, 3)
    vertices = np.concatenate([edges, paths[:, -1:]], axis=1)
    left = 2 * np.arange(length - 2)
    quads = np.stack([left, left + 1, left + 3, left + 2], axis=1)
    tip = 2 * (length - 1)
    pattern = np.vstack([quads, [tip - 2, tip - 1, tip, -1]])
    v = np.repeat(np.linspace(0.0, 1.0, length)[:-1], 2)
    u = np.concatenate([np.tile([0.0, 1.0], length - 1), [0.5]])
    place = np.column_stack([u, np.append(v, 1.0)])
    uv = np.where(pattern[..., None] < 0, 0.0, place[pattern])
    uv = np.tile(uv, (count, 1, 1, 1))
    uv[..., 0] = columns[:, :1, None] + uv[..., 0] * np.diff(columns)[:, :, None]
    uv[np.broadcast_to(pattern < 0, uv.shape[:3])] = 0.0
    start = vertices.shape[1] * np.arange(count)[:, None, None]
    faces = np.where(pattern < 0, -1, pattern + start)
    return Shape(vertices.reshape(-1, 3), faces.reshape(-1, 4), uv.reshape(-1, 4, 2))


def joined(*shapes: Shape) -> Shape:
    """Join several meshes."""
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    faces = [np.where(s.faces < 0, -1, s.faces + start) for s, start in zip(shapes, starts, strict=True)]
    return Shape(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate(faces),
        np.concatenate([shape.uv for shape in shapes]),
    )


def along(paths: Points) -> Points:
    """Unit tangents of paths (N, K, 3)."""
    return unit(np.gradient(paths, axis=1))


def unit(vectors: Points) -> Points:
    """Vectors (..., 3) with length 1."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def sideways(paths: Points, normals: Points, half: NDArray[np.float64], twist: NDArray[np.float64]) -> Points:
    """Vectors from the middle of each strip to an edge, (N, K, 3).

    `normals` (N, K, 3) point away from what is covered; `half` (N, K) are half widths and `twist` (N, 1) angles by
    which strips are turned about their paths.
    """
    side = unit(np.cross(along(paths), normals))
    up = np.cross(side, along(paths))
    turned = np.cos(twist)[..., None] * side + np.sin(twist)[..., None] * up
    return np.asarray(half[..., None] * turned)
