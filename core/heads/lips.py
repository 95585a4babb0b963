"""The line between joined lips along which a mesh is cut to open its mouth (method.md, section 7.3)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import MOUTH_CORNERS, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray

_BETWEEN = (0.25, 0.5, 0.75)
"""Positions of the inner landmarks of each lip, as shares of the line's length."""
_MIN_VERTICES = 7
"""Smallest number of vertices of the line: both corners, the three landmarks of a lip, and one between any two."""


def lip_line(graph: SurfaceGraph, landmarks: IntArray) -> NDArray[np.intp]:
    """Find a line of edges between the lips.

    Parameters
    ----------
    graph : SurfaceGraph
        Graph of the head.
    landmarks : (66,) array of int
        Vertex of each landmark.

    Returns
    -------
    (N,) int
        Vertices from the right corner of the mouth to the left one.

    Raises
    ------
    HeadError
        If no line of edges leads along the skin from corner to corner, or it has too few vertices.
    """
    right, left = (int(v) for v in landmarks[MOUTH_CORNERS])
    points = graph.vertices[landmarks]
    between = (points[MOUTH_INNER_UPPER] + points[MOUTH_INNER_LOWER[::-1]]) / 2.0
    shares = np.array(_BETWEEN)[:, None]
    chord = graph.vertices[right] * (1.0 - shares) + graph.vertices[left] * shares
    # The median, as one of the three pairs may be off on a scan with flat lips.
    middle = chord[1] + np.median(between - chord, axis=0)
    stops = [right, int(np.argmin(np.linalg.norm(graph.vertices - middle, axis=1))), left]
    line = [right]
    for start, end in pairwise(stops):
        for vertex in graph.path(start, end)[1:]:
            # A path that returns to the line has gone around something: drop the loop.
            line = line[: line.index(vertex) + 1] if vertex in line else [*line, vertex]
    joined = all(b in graph.neighbours(a) for a, b in pairwise(line))
    if not joined:
        raise HeadError("No line of edges leads from one mouth corner to the other. Find the face again.")
    if len(line) < _MIN_VERTICES:
        raise HeadError("The mesh is too coarse between the lips. Subdivide the mouth first.")
    return np.array(line, dtype=np.intp)


def rim_landmarks(points: FloatArray) -> NDArray[np.intp]:
    """Return the indices, (3,), into the line through `points` (N, 3) for the inner landmarks of a lip."""
    return nearest_at_shares(points, _BETWEEN)


def nearest_at_shares(points: FloatArray, shares: Sequence[float]) -> NDArray[np.intp]:
    """Select the points of a line that are nearest to given shares of its length.

    Parameters
    ----------
    points : (N, 3) float64
        The line, with ``N >= S + 2``.
    shares : sequence of float
        Ascending shares of the length, S of them.

    Returns
    -------
    (S,) int
        Different indices, none of them an end.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), 1e-12)
    chosen = np.array([int(np.argmin(np.abs(along[1:-1] - share))) + 1 for share in shares])
    # On uneven edges two shares may select the same vertex; move on to the next, for which the line has room.
    for i in range(1, len(chosen)):
        chosen[i] = max(chosen[i], chosen[i - 1] + 1)
    return np.minimum(chosen, len(points) - 1 - len(chosen) + np.arange(len(chosen)))
