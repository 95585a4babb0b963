"""Visible faces of a mesh per pixel, without a renderer."""

from __future__ import annotations

import numpy as np


def seen(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, reach: float, size: int = 160) -> np.ndarray:
    """(size, size) the face seen at each place, -1 where none is: from the front, `reach` to each side of `centre`.

    `vertices` (V, 3) are in the head frame, `faces` (F, K) padded with -1.
    """
    places = np.asarray(vertices, dtype=float) - centre
    scale = size / (2.0 * reach)
    depth, found = np.full((size, size), np.inf), np.full((size, size), -1)
    for i in range(1, faces.shape[1] - 1):
        for face in np.flatnonzero(faces[:, i + 1] >= 0):
            corners = places[faces[face, [0, i, i + 1]]]
            if (np.abs(corners[:, :2]).min(axis=0) < reach).all():
                _draw((corners[:, :2] + reach) * scale - 0.5, corners[:, 2], face, depth, found)
    return found


def _draw(corners: np.ndarray, far: np.ndarray, face: int, depth: np.ndarray, found: np.ndarray) -> None:
    low = np.maximum(np.ceil(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.floor(corners.max(axis=0)).astype(int), len(depth) - 1)
    (ax, ay), (bx, by) = corners[1:] - corners[0]
    twice = ax * by - ay * bx
    if (high < low).any() or twice == 0.0:
        return
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1) - corners[0, 0], np.arange(low[1], high[1] + 1) - corners[0, 1])
    second, third = (x * by - y * bx) / twice, (ax * y - ay * x) / twice
    here = far[0] + second * (far[1] - far[0]) + third * (far[2] - far[0])
    part = np.s_[low[1] : high[1] + 1, low[0] : high[0] + 1]
    nearer = (second >= 0.0) & (third >= 0.0) & (second + third <= 1.0) & (here < depth[part])
    depth[part][nearer], found[part][nearer] = here[nearer], face
