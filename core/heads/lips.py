"""The line between lips that are one skin, along which a mesh is cut so that its mouth can open."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..errors import HeadError
from ..landmarks import MOUTH_CORNERS, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER
from ..mesh.surface import SurfaceGraph

_BETWEEN = (0.25, 0.5, 0.75)
"""Where along the line the inner landmarks of each lip lie."""
_LEAST = 7
"""Vertices of the line: corners, and one for each of three landmarks of a lip with one between."""


def lip_line(graph: SurfaceGraph, landmarks: IntArray) -> NDArray[np.intp]:
    """(N,) vertices along the edges of a mesh from the right mouth corner between the lips to the left one.

    Parameters
    ----------
    graph : SurfaceGraph
        Of the head.
    landmarks : (66,) array of int

    Raises
    ------
    HeadError
        Where no line leads along the skin, or it has too few vertices.
    """
    right, left = (int(v) for v in landmarks[MOUTH_CORNERS])
    points = graph.vertices[landmarks]
    between = (points[MOUTH_INNER_UPPER] + points[MOUTH_INNER_LOWER[::-1]]) / 2.0
    shares = np.array(_BETWEEN)[:, None]
    chord = graph.vertices[right] * (1.0 - shares) + graph.vertices[left] * shares
    # One of the three pairs may be off, on a scan whose lips are hardly there.
    middle = chord[1] + np.median(between - chord, axis=0)
    stops = [right, int(np.argmin(np.linalg.norm(graph.vertices - middle, axis=1))), left]
    line = [right]
    for start, end in pairwise(stops):
        for vertex in graph.path(start, end)[1:]:
            # A path that meets the line again has gone round something: what lies between is left out.
            line = line[: line.index(vertex) + 1] if vertex in line else [*line, vertex]
    joined = all(b in graph.neighbours(a) for a, b in pairwise(line))
    if not joined:
        raise HeadError("No line of edges leads from one mouth corner to the other. Bind the landmarks anew.")
    if len(line) < _LEAST:
        raise HeadError("The mesh is too coarse between the lips. Subdivide the mouth first.")
    return np.array(line, dtype=np.intp)


def rim_landmarks(points: FloatArray) -> NDArray[np.intp]:
    """(3,) positions where a lip's inner landmarks lie on the line through `points` (N, 3)."""
    return at_shares(points, _BETWEEN)


def at_shares(points: FloatArray, shares: Sequence[float]) -> NDArray[np.intp]:
    """(S,) different ones of `points` (N, 3), no ends, nearest to the `shares` of the line's length; N >= S + 2."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), 1e-12)
    chosen = np.array([int(np.argmin(np.abs(along[1:-1] - share))) + 1 for share in shares])
    # Uneven edges may give one vertex twice; neighbours are free, as the line has room.
    for i in range(1, len(chosen)):
        chosen[i] = max(chosen[i], chosen[i - 1] + 1)
    return np.minimum(chosen, len(points) - 1 - len(chosen) + np.arange(len(chosen)))
