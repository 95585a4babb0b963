"""Share of the sky that each vertex sees: shade for nostrils, ears, lids and the fold below the lip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_RAYS = 96
_NEAR = 4e-4
_REACH = 0.05


def openness(vertices: NDArray[np.float64], faces: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Share, 0 to 1, of the half space over the vertices `rows` that nothing within 5 cm covers, (len(rows),)."""
    triangles = np.concatenate([faces[:, :3], faces[faces[:, 3] >= 0][:, [0, 2, 3]]])
    a = vertices[triangles[:, 0]]
    u, v = vertices[triangles[:, 1]] - a, vertices[triangles[:, 2]] - a
    normals = vertex_normals(vertices, faces)
    directions = _half_sphere()
    return np.array([_open(vertices[i] + _NEAR * normals[i], normals[i], directions, a, u, v) for i in rows])


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Outward unit normals, (V, 3), with faces weighted by area."""
    normals = np.zeros_like(vertices)
    for corners in ([0, 1, 2], [0, 2, 3]):
        triangles = faces[faces[:, corners[-1]] >= 0][:, corners]
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        for i in range(3):
            np.add.at(normals, triangles[:, i], np.cross(b - a, c - a))
    return np.asarray(normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12))


def _half_sphere() -> NDArray[np.float64]:
    """Directions about +z, spread evenly and weighted by the cosine."""
    i = np.arange(_RAYS) + 0.5
    height = np.sqrt(1.0 - i / _RAYS)
    angle = i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height**2)
    return np.stack([width * np.cos(angle), width * np.sin(angle), height], axis=1)


def _open(
    origin: NDArray[np.float64],
    normal: NDArray[np.float64],
    directions: NDArray[np.float64],
    a: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
) -> float:
    """Moeller and Trumbore's test of every ray against the triangles near `origin`."""
    near = np.linalg.norm(a + (u + v) / 3.0 - origin, axis=1) < _REACH + 0.01
    a, u, v = a[near], u[near], v[near]
    side = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    rays = directions @ np.stack([side, np.cross(normal, side), normal])
    p = np.cross(rays[:, None], v[None])
    det = (u[None] * p).sum(axis=2)
    det = np.where(np.abs(det) < 1e-14, np.inf, det)
    s = origin - a
    first = (s[None] * p).sum(axis=2) / det
    q = np.cross(s, u)
    second = rays @ q.T / det
    way = (v * q).sum(axis=1)[None] / det
    hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (way > 0) & (way < _REACH)
    return float(1.0 - hit.any(axis=1).mean())
