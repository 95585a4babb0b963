"""Lower teeth and gums stay behind the skin that covers them (method.md, section 5.10).

A smile draws lips back. The lower teeth and gums of many avatars are so close behind the skin that they would come out
below the lip. The upper lip rises at the same time, and uncovers its teeth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import LOWER_LIPS, MOUTH_CORNERS
from ..heads.rig import HeadRig, Part
from ..mesh.surface import triangulate
from ..numeric.arrays import FloatArray, IntArray

_APART = 0.06
"""Distance from the skin, in outer-eye distances, that is kept unless they are closer at rest. Chosen on one avatar,
where at 0.02 triangles between the vertices still came out; an anime figure confirms it."""
_UNSURE = 0.25
"""Share of the distance across the face by which a vertex has moved from the skin before it, that is kept in addition:
skin is no plane."""
_STEEPEST = 1.0
"""Largest slope of the skin, depth over distance across the face, at which it counts: on the edge of a lip it is too
steep to tell its depth beside."""
_DEEPEST = 0.2
"""Distance from the skin beyond which they are left alone. A broad smile draws the lip of that avatar back by 0.06."""


class Gums:
    """Keeps lower teeth and gums behind the skin before them, for a rig of a head and that of its `skin` alone.

    The vertices of the `tongue` (A,) may come out.

    Attributes
    ----------
    rows : (G,) intp
        Vertices of the head that are kept behind its skin.
    """

    def __init__(self, rig: HeadRig, skin: HeadRig, tongue: NDArray[np.bool_]) -> None:
        landmarks = np.asarray(skin.vertices, dtype=np.float64)[skin.landmarks]
        places, unit = rig.all_vertices.astype(np.float64), rig.eye_distance
        rim = landmarks[[MOUTH_CORNERS[0], *LOWER_LIPS, MOUTH_CORNERS[1]]]
        rows = np.flatnonzero((rig.kinds == Part.TEETH_LOWER) & ~tongue)
        rows = rows[places[rows, 1] - np.interp(places[rows, 0], rim[:, 0], rim[:, 1]) > 0.0]
        triangles = np.empty((0, 3), dtype=np.intp) if skin.faces is None else triangulate(skin.faces)
        corners, weights, room = _covers(places[rows], np.asarray(skin.vertices, dtype=np.float64), triangles)
        near = room < _DEEPEST * unit
        self.rows, self._corners = rows[near], corners[near]
        self._weights = weights[near].astype(np.float32)
        self._apart = np.minimum(room[near], _APART * unit).astype(np.float32)
        self._rest = np.asarray(skin.vertices, dtype=np.float32)
        self._start = rig.all_vertices[self.rows, :2].astype(np.float32)
        self._slopes = _slopes(self._rest[self._corners].astype(np.float64)).astype(np.float32)

    def table(self) -> NDArray[np.float32]:
        """Return what `hold` uses, for evaluation in another program, (G, 3, 4).

        First the corners of the triangle of the skin before each vertex, and the least depth of the vertex at rest;
        then their weights, and 0; last the slopes of the skin along x and y, the share of the distance that it has slid
        across the vertex, and 0.
        """
        corners = np.column_stack([self._corners, self._least()])
        rows = [corners, *(np.pad(own, ((0, 0), (0, 4 - own.shape[1]))) for own in (self._weights, self._slopes))]
        rows[2][:, 2] = _UNSURE
        return np.asarray(np.stack(rows, axis=1), dtype=np.float32)

    def hold(self, out: NDArray[np.float32], skin: NDArray[np.float32]) -> None:
        """Move gums among the vertices of a head (A, 3) back behind its skin (U, 3), in place."""
        moved = np.einsum("gk,gkc->gc", self._weights, (skin - self._rest)[self._corners])
        beside = out[self.rows, :2] - self._start - moved[:, :2]
        away = np.sqrt(np.square(beside).sum(axis=1))
        depth = self._least() + moved[:, 2] + (self._slopes * beside).sum(axis=1) + np.float32(_UNSURE) * away
        out[self.rows, 2] = np.maximum(out[self.rows, 2], depth)

    def _least(self) -> NDArray[np.float32]:
        """Least depth of each vertex at rest, (G,)."""
        return np.asarray(np.einsum("gk,gk->g", self._weights, self._rest[self._corners][:, :, 2]) + self._apart)


def _slopes(triangles: FloatArray) -> FloatArray:
    """Increase of depth along x and y on triangles (G, 3, 3), (G, 2), at most `_STEEPEST`."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facing = np.where(normals[:, 2] == 0.0, np.inf, normals[:, 2])
    slopes = -normals[:, :2] / facing[:, None]
    size = np.linalg.norm(slopes, axis=1, keepdims=True)
    return np.asarray(slopes * np.minimum(1.0, _STEEPEST / np.maximum(size, 1e-9)))


def _covers(
    points: FloatArray, vertices: FloatArray, triangles: IntArray
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Find the skin that covers points (N, 3), seen from the front.

    Returns the corners (N, 3) of the foremost triangle in front of each point, their weights (N, 3), and the distance
    (N,) to it, infinite for points that nothing covers. Walls of the mouth may lie between the two.
    """
    corners = np.zeros((len(points), 3), dtype=np.intp)
    weights, room = np.zeros((len(points), 3)), np.full(len(points), np.inf)
    if not len(points):
        return corners, weights, room
    flat = vertices[triangles][:, :, :2]
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    triangles = triangles[(flat.max(axis=1) >= low).all(axis=1) & (flat.min(axis=1) <= high).all(axis=1)]
    origin = vertices[triangles[:, 0]]
    first, second = (vertices[triangles[:, k]] - origin for k in (1, 2))
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    area = np.where(area == 0.0, np.nan, area)
    for row, point in enumerate(points):
        off = point - origin
        u = (off[:, 0] * second[:, 1] - off[:, 1] * second[:, 0]) / area
        v = (first[:, 0] * off[:, 1] - first[:, 1] * off[:, 0]) / area
        before = off[:, 2] - u * first[:, 2] - v * second[:, 2]
        found = np.flatnonzero((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (before > 0.0))
        if len(found):
            best = found[np.argmax(before[found])]
            corners[row], room[row] = triangles[best], before[best]
            weights[row] = 1.0 - u[best] - v[best], u[best], v[best]
    return corners, weights, room
