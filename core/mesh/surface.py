"""Paths along the surface of a mesh, its pieces and openings, which separate lips and lids that touch, and nearest
points.

The tree is that of OpenCV's FLANN. scipy's `cKDTree` takes 1.2 to 1.9 times as long to build and to search, for the
built-in head and 33,000 vertices of a finer one, in three and six dimensions.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import LOWER_LIP, MOUTH_CORNERS, UPPER_LIP
from ..numeric.arrays import FloatArray, IntArray

_SINGLE_TREE = 4
"""FLANN's number for the k-d tree for few dimensions, the only index with an exact search."""
_SAME_PLACE = 1e-6
"""Share of the mesh's size within which vertices coincide."""
JOINED = 1.7
"""Lips or lids count as joined if the path from one to the other is shorter than this multiple of the straight
distance. Around a corner of the mouth it is longer."""


class NearestPoints:
    """Finds the nearest of a set of points: O(N log N) to prepare, O(log N) per query.

    Parameters
    ----------
    points : (N, D) array_like
        The points, searched in single precision.
    """

    def __init__(self, points: FloatArray) -> None:
        self._points = np.ascontiguousarray(points, dtype=np.float32)  # the tree keeps no copy
        tree = {"algorithm": _SINGLE_TREE, "leaf_max_size": 10}
        self._index = cv2.flann_Index(self._points, tree)  # type: ignore[attr-defined] # missing from its stubs

    def query(self, places: FloatArray, count: int = 1) -> tuple[NDArray[np.intp], FloatArray]:
        """Find the points nearest to each position.

        Parameters
        ----------
        places : (M, D) array_like
            The positions.
        count : int
            Number of points per position.

        Returns
        -------
        indices : (M, count) int
            The nearest first.
        squared : (M, count) float32
            Squared distances.
        """
        queries = np.ascontiguousarray(places, dtype=np.float32)
        if not len(queries):  # the index would return None
            return np.empty((0, count), dtype=np.intp), np.empty((0, count), dtype=np.float32)
        found, squared = self._index.knnSearch(queries, count, params={"checks": -1})
        return np.asarray(found, dtype=np.intp), squared


def border_twins(vertices: FloatArray, faces: IntArray, apart: IntArray | None = None) -> NDArray[np.intp]:
    """Find coincident vertices of open borders, where a skin was split, as exporters do at texture seams.

    Parameters
    ----------
    vertices : (V, 3) array
        Any frame and unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    apart : (N,) array of int, optional
        Vertices of borders that are openings, such as lips that were cut apart.

    Returns
    -------
    (V,) intp
        For each vertex the first of those that coincide with it. Vertices inside the mesh are not joined, as another
        layer may touch them.
    """
    graph = SurfaceGraph(vertices, faces)
    border = np.setdiff1d(graph.edges[graph.faces_at == 1], [] if apart is None else apart)
    first = np.arange(len(graph.vertices))
    if len(border):
        extent = max(float(np.ptp(graph.vertices, axis=0).max()), 1e-30)
        places = np.round(graph.vertices[border] / (_SAME_PLACE * extent)).astype(np.int64)
        _, leader, group = np.unique(places, axis=0, return_index=True, return_inverse=True)
        first[border] = border[leader[group.reshape(-1)]]
    return first


def islands(count: int, faces: IntArray, twins: IntArray | None = None) -> NDArray[np.intp]:
    """Number the connected pieces of a mesh.

    Parameters
    ----------
    count : int
        Number of vertices.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    twins : (V,) array of int, optional
        As returned by `border_twins`; pieces are connected across twins.

    Returns
    -------
    (V,) intp
        Number of the piece of each vertex, from 0. A vertex without faces is a piece of its own.
    """
    corners = np.where(faces >= 0, faces, faces[:, :1]).astype(np.intp)
    label = np.arange(count) if twins is None else np.array(twins, dtype=np.intp)
    root = label[label]
    while True:
        # Union by propagation: each face takes its lowest label, each vertex the lowest of its faces, and each label
        # the label of the vertex that it names.
        low = root[corners].min(axis=1) if len(corners) else np.empty(0, dtype=np.intp)
        new = root.copy()
        np.minimum.at(new, corners.ravel(), np.repeat(low, corners.shape[1]))
        np.minimum.at(new, root, new.copy())
        np.minimum.at(new, label, new.copy())
        new = np.minimum(new, new[label])
        new = new[new]
        if np.array_equal(new, root):
            break
        root = new
    return np.asarray(np.unique(root, return_inverse=True)[1].reshape(-1), dtype=np.intp)


def triangulate(faces: IntArray) -> NDArray[np.intp]:
    """Divide faces (F, K), padded with -1, into triangles (T, 3) that share the first corner of their face."""
    whole = np.asarray(faces, dtype=np.intp)
    fans = [whole[whole[:, k] >= 0][:, [0, k - 1, k]] for k in range(2, whole.shape[1])]
    return np.concatenate(fans) if fans else np.empty((0, 3), np.intp)


def surface_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals of vertices, weighted by the areas of their faces.

    Parameters
    ----------
    vertices : (V, 3) array
        Any frame and unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.

    Returns
    -------
    (V, 3) float64
        Normals; 0 for vertices without faces.
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
        self._neighbours: list[int] = both[order, 1].tolist()
        self._lengths: list[float] = np.tile(length, 2)[order].tolist()
        self._starts: list[int] = np.searchsorted(both[order, 0], np.arange(len(self.vertices) + 1)).tolist()

    def neighbours(self, vertex: int) -> list[int]:
        """Return the vertices that are one edge away from `vertex`."""
        return self._neighbours[self._starts[vertex] : self._starts[vertex + 1]]

    def path_lengths(self, seeds: Iterable[int], limit: float = np.inf) -> FloatArray:
        """Compute the length of the shortest path along edges from each vertex to any seed.

        Parameters
        ----------
        limit : float
            Length at which to stop.

        Returns
        -------
        (V,) float64
            Lengths; infinite beyond `limit`.
        """
        way = np.full(len(self.vertices), np.inf)
        for vertex, (length, _) in self._search(seeds, limit).items():
            way[vertex] = length
        return way

    def nearest_seeds(self, seeds: Iterable[int]) -> NDArray[np.intp]:
        """Find the seed that is nearest to each vertex along edges.

        Returns
        -------
        (V,) intp
            The seed; -1 for vertices that are connected to none.
        """
        nearest = np.full(len(self.vertices), -1)
        for vertex, (_, before) in self._search(seeds, np.inf).items():  # in order of distance
            nearest[vertex] = vertex if before == vertex else nearest[before]
        return nearest

    def path(self, start: int, end: int) -> list[int]:
        """Find the shortest path along edges.

        Returns
        -------
        list of int
            Vertices from `start` to `end`; only these two if they are not connected.
        """
        reached = self._search([start], np.inf, end)
        if end not in reached:
            return [start, end]
        path = [end]
        while path[-1] != start:
            path.append(reached[path[-1]][1])
        return path[::-1]

    def openings(self) -> list[NDArray[np.intp]]:
        """Return the connected borders of the mesh as arrays of vertices, the longest first."""
        border = self.edges[self.faces_at == 1]
        label = {int(v): int(v) for v in np.unique(border)}

        def root(v: int) -> int:
            while label[v] != v:
                label[v] = label[label[v]]
                v = label[v]
            return v

        # Union-find: join the ends of each border edge.
        for a, b in border.tolist():
            label[root(a)] = root(b)
        pieces: dict[int, list[int]] = {}
        for v in label:
            pieces.setdefault(root(v), []).append(v)
        return sorted((np.array(piece) for piece in pieces.values()), key=len, reverse=True)

    def _search(self, seeds: Iterable[int], limit: float, end: int = -1) -> dict[int, tuple[float, int]]:
        """Dijkstra's algorithm: the vertices within `limit` of `seeds`, each with its distance and predecessor.

        With an `end`, vertices on the straight way to it come first (A*), and the search ends there.
        """
        done: dict[int, tuple[float, int]] = {}
        ahead = np.zeros(len(self.vertices))
        if end >= 0:
            ahead = np.linalg.norm(self.vertices - self.vertices[end], axis=1)
        left: list[float] = ahead.tolist()
        heap = [(left[int(seed)], int(seed), int(seed), 0.0) for seed in seeds]
        heapq.heapify(heap)
        while heap:
            _, vertex, before, distance = heapq.heappop(heap)
            if vertex in done:
                continue
            done[vertex] = (distance, before)
            if vertex == end:
                break
            for i in range(self._starts[vertex], self._starts[vertex + 1]):
                further, neighbour = distance + self._lengths[i], self._neighbours[i]
                if further <= limit and neighbour not in done:
                    heapq.heappush(heap, (further + left[neighbour], neighbour, vertex, further))
        return done


def lips_joined(graph: SurfaceGraph, landmarks: IntArray) -> bool:
    """Return whether the lips are one skin, that is, whether the path along the surface from lip to lip is short.

    Parameters
    ----------
    graph : SurfaceGraph
        Graph of the head.
    landmarks : (66,) int
        Vertex of each landmark.

    Returns
    -------
    bool
        Whether they are joined.

    Notes
    -----
    Paths are measured between the outer rims of the lips, whose landmarks are away from any slit.
    """
    upper, lower = landmarks[UPPER_LIP[1:4]], landmarks[LOWER_LIP[1:4]]
    across = np.linalg.norm(graph.vertices[upper] - graph.vertices[lower], axis=1)
    width = float(np.linalg.norm(np.subtract(*graph.vertices[landmarks[MOUTH_CORNERS]])))
    lengths = [graph.path_lengths([int(u)], 2.0 * width)[v] for u, v in zip(upper, lower, strict=True)]
    return bool((np.array(lengths) < JOINED * across).any())


def _edges(faces: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Unique edges, (E, 2), and the number of faces at each, (E,)."""
    counts = (faces >= 0).sum(axis=1)
    pairs = [
        np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=-1).reshape(-1, 2)
        for count in np.unique(counts)
        if count > 1
        for polygons in [faces[counts == count, :count]]
    ]
    every = np.sort(np.concatenate(pairs), axis=1) if pairs else np.empty((0, 2), dtype=np.intp)
    width = int(every.max(initial=0)) + 1
    keys, faces_at = np.unique(every[:, 0] * width + every[:, 1], return_counts=True)
    return np.stack([keys // width, keys % width], axis=1), faces_at
