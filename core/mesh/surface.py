"""Paths along the surface of a mesh, its pieces and openings, which separate lips and lids that touch, and nearest
points.

The tree is that of OpenCV's FLANN. scipy's `cKDTree` takes 1.2 to 1.9 times as long to build and to search, for the
built-in head and 33,000 vertices of a finer one, in three and six dimensions.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray

_SINGLE_TREE = 4
"""FLANN's number for the k-d tree for few dimensions, the only index with an exact search."""
_DETOUR = 3.0
"""Length of a path along the surface, relative to the straight line, up to which it is sought first."""
_SAME_PLACE = 1e-6
"""Share of the mesh's size within which vertices coincide."""


class NearestPoints:
    """Finds the nearest of N points (N, D) in single precision: O(N log N) to prepare, O(log N) per query."""

    def __init__(self, points: FloatArray) -> None:
        self._points = np.ascontiguousarray(points, dtype=np.float32)  # the tree keeps no copy
        tree = {"algorithm": _SINGLE_TREE, "leaf_max_size": 10}
        self._index = cv2.flann_Index(self._points, tree)  # type: ignore[attr-defined] # missing from its stubs

    def query(self, places: FloatArray, count: int = 1) -> tuple[NDArray[np.intp], FloatArray]:
        """Find the `count` points nearest to each place (M, D): indices and squared distances (M, count), ascending."""
        queries = np.ascontiguousarray(places, dtype=np.float32)
        if not len(queries):  # the index would return None
            return np.empty((0, count), dtype=np.intp), np.empty((0, count), dtype=np.float32)
        found, squared = self._index.knnSearch(queries, count, params={"checks": -1})
        return np.asarray(found, dtype=np.intp), squared


def border_twins(vertices: FloatArray, faces: IntArray, apart: IntArray | None = None) -> NDArray[np.intp]:
    """Find coincident vertices of open borders, where a skin was split, as exporters do at texture seams.

    Returns for each vertex the first of those that coincide with it, (V,). Vertices inside the mesh are not joined, as
    another layer may touch them, nor are those that are `apart`, on borders of openings, such as lips that were cut
    apart.
    """
    graph = SurfaceGraph(vertices, faces)
    border = np.setdiff1d(graph.edges[graph.faces_at == 1], [] if apart is None else apart)
    first = np.arange(len(graph.vertices))
    if len(border):
        first[border] = border[_coincident(graph.vertices, border)]
    return first


def touching(vertices: FloatArray, border: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return those vertices of a border (N,) that coincide with another one of it, as where lips were cut apart."""
    leader = _coincident(np.asarray(vertices, dtype=np.float64), border)
    return np.asarray(border[np.bincount(leader, minlength=len(border))[leader] > 1], dtype=np.intp)


def _coincident(vertices: FloatArray, chosen: IntArray) -> NDArray[np.intp]:
    """Number, among some vertices (N,), of the first one at the place of each, (N,)."""
    extent = max(float(np.ptp(vertices, axis=0).max()), 1e-30)
    places = np.round(vertices[chosen] / (_SAME_PLACE * extent)).astype(np.int64)
    _, leader, group = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return np.asarray(leader[group.reshape(-1)], dtype=np.intp)


def islands(count: int, faces: IntArray, twins: IntArray | None = None) -> NDArray[np.intp]:
    """Number the connected pieces of a mesh of `count` vertices: for each the number of its piece, from 0.

    A vertex without faces is a piece of its own. Pieces are connected across `twins`, as returned by `border_twins`.
    """
    corners = np.where(faces >= 0, faces, faces[:, :1]).astype(np.intp)
    pairs = np.stack([np.broadcast_to(corners[:, :1], corners.shape), corners], axis=-1).reshape(-1, 2)
    joined = pairs if twins is None else np.concatenate([pairs, np.column_stack([np.arange(count), twins])])
    return connected(count, joined)


def connected(count: int, edges: IntArray) -> NDArray[np.intp]:
    """Number the pieces that edges (E, 2) connect, (count,), in the order of their first vertices."""
    graph = linalg.part("sparse").coo_matrix((np.ones(len(edges)), tuple(edges.T)), (count, count))
    return np.asarray(linalg.part("sparse.csgraph").connected_components(graph, directed=False)[1], dtype=np.intp)


def triangulate(faces: IntArray) -> NDArray[np.intp]:
    """Divide faces (F, K), padded with -1, into triangles (T, 3) that share the first corner of their face."""
    whole = np.asarray(faces, dtype=np.intp)
    fans = [whole[whole[:, k] >= 0][:, [0, k - 1, k]] for k in range(2, whole.shape[1])]
    return np.concatenate(fans) if fans else np.empty((0, 3), np.intp)


def surface_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3) of vertices, weighted by the areas of their faces; 0 for vertices without faces.

    Vertices (V, 3) have any frame and unit; faces (F, K) are padded with -1.
    """
    triangles = triangulate(faces)
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(across[:, i], 3), len(vertices)) for i in range(3)], axis=1
    )
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))


class SurfaceGraph:
    """The graph of vertices and edges of a mesh, weighted by length.

    Parameters
    ----------
    vertices, faces
        As for `surface_normals`.

    Attributes
    ----------
    edges : (E, 2) intp
        Each edge once, with the smaller index first.
    faces_at : (E,) intp
        Number of faces at each edge; 1 at a border.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self.vertices = np.asarray(vertices, dtype=np.float64)
        self.edges, self.faces_at = _edges(np.asarray(faces, dtype=np.intp))
        length = np.linalg.norm(np.subtract(*self.vertices[self.edges.T]), axis=1)
        both = np.concatenate([self.edges, self.edges[:, ::-1]])
        order = np.argsort(both[:, 0], kind="stable")
        starts = np.searchsorted(both[order, 0], np.arange(len(self.vertices) + 1))
        lengths = np.tile(length, 2)[order], both[order, 1], starts
        self._graph = linalg.part("sparse").csr_matrix(lengths, (len(self.vertices), len(self.vertices)))

    def neighbours(self, vertex: int) -> list[int]:
        """Return the vertices that are one edge away from `vertex`."""
        first, end = self._graph.indptr[vertex : vertex + 2]
        found: list[int] = self._graph.indices[first:end].tolist()
        return found

    def path_lengths(self, seeds: Iterable[int], limit: float = np.inf) -> FloatArray:
        """Compute the length (V,) of the shortest path from each vertex to any seed; infinite beyond `limit`."""
        return self._search(seeds, limit)[0]

    def nearest_seeds(self, seeds: Iterable[int]) -> NDArray[np.intp]:
        """Find the seed that is nearest to each vertex along edges (V,); -1 for vertices that are connected to none."""
        return np.maximum(self._search(seeds)[2], -1)

    def path(self, start: int, end: int) -> list[int]:
        """Find the shortest path along edges, from `start` to `end`; only these two if they are not connected."""
        # A path is hardly ever much longer than the straight line, and to search that far takes a fraction of the time.
        nearby = _DETOUR * float(np.linalg.norm(self.vertices[end] - self.vertices[start]))
        before, path = self._search([start], nearby)[1], [end]
        if before[end] < 0:
            before = self._search([start])[1]
        while path[-1] != start and before[path[-1]] >= 0:
            path.append(int(before[path[-1]]))
        return path[::-1] if path[-1] == start else [start, end]

    def openings(self) -> list[NDArray[np.intp]]:
        """Return the connected borders of the mesh as arrays of vertices, the longest first."""
        border = self.edges[self.faces_at == 1]
        vertices = np.unique(border)
        piece = connected(len(self.vertices), border)[vertices]
        order = np.argsort(piece, kind="stable")
        pieces = np.split(vertices[order], np.flatnonzero(np.diff(piece[order])) + 1) if len(order) else []
        return sorted(pieces, key=len, reverse=True)

    def _search(self, seeds: Iterable[int], limit: float = np.inf) -> tuple[FloatArray, IntArray, IntArray]:
        """Dijkstra's algorithm: the distance of each vertex from `seeds`, its predecessor, and the seed nearest to it;
        infinity and negative numbers beyond `limit`.
        """
        indices = np.unique(np.fromiter(seeds, dtype=np.intp))
        found: tuple[FloatArray, IntArray, IntArray] = linalg.part("sparse.csgraph").dijkstra(
            self._graph, indices=indices, return_predecessors=True, limit=limit, min_only=True
        )
        return found


def _edges(faces: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Unique edges, (E, 2), and the number of faces at each, (E,)."""
    every = np.sort(edges_of(faces), axis=1)
    width = int(every.max(initial=0)) + 1
    keys, faces_at = np.unique(every[:, 0] * width + every[:, 1], return_counts=True)
    return np.stack([keys // width, keys % width], axis=1), faces_at


def edges_of(faces: IntArray) -> NDArray[np.intp]:
    """Return the edges, (E, 2), of faces (F, K) that are padded with -1."""
    following: NDArray[np.intp] = np.roll(faces, -1, axis=1)
    last = (faces >= 0) & (following < 0)
    following = np.where(last, faces[:, :1], following)
    pairs = np.stack([faces, following], axis=-1).reshape(-1, 2)
    return np.asarray(pairs[(pairs >= 0).all(axis=1)], dtype=np.intp)
