"""Contact between the lips, and between the lids of an eye (method.md, section 9.6); the line between joined lips
(section 7.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import (
    EYE_LEFT,
    EYE_RIGHT,
    LIPS,
    LOWER_LIP,
    LOWER_LIPS,
    MOUTH_CORNERS,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    UPPER_LIP,
    UPPER_LIPS,
    outer_eye_distance,
)
from ..mesh.surface import NearestPoints, SurfaceGraph, surface_normals, triangulate
from ..mesh.triangles import crossing_pairs
from ..numeric.arrays import FloatArray, IntArray

_LID_ATTEMPTS = ((1, 0.04), (1, 0.02))
"""Attempts that are made at the lids until nothing crosses: how many of the nearest vertices across the slit a vertex
must not pass, and the largest distance along the slit at which they count. All lengths are in outer-eye distances."""
_LIP_ATTEMPTS = ((3, 0.04), (1, 0.04), (3, 0.02), (6, 0.02))
"""Attempts at the lips. Thick lips need more neighbours than thin lids."""
_BETWEEN = (0.25, 0.5, 0.75)
"""Positions of the inner landmarks of each lip, as shares of the line's length."""
_MIN_VERTICES = 7
"""Smallest number of vertices of the line: both corners, the three landmarks of a lip, and one between any two."""


_SLITS = (
    (EYE_RIGHT, 0, 0.002, _LID_ATTEMPTS),
    (EYE_LEFT, 0, 0.002, _LID_ATTEMPTS),
    (LIPS, 1, 0.003, _LIP_ATTEMPTS),
)
"""For each slit: its landmarks, the region above it (the next region is below), the distance kept between its sides
(that at rest if smaller), and the attempts."""
_REACH = 0.12
"""Distance from the landmarks of a slit within which skin belongs to it."""
_GAPING = 0.5
"""Distance between the inner rims of the lips, relative to that between the outer ones, above which a mouth is open."""
_MIN_DEPTH = 1e-4
"""Depth above which a vertex counts as having passed through a plane."""
_MAX_DEPTH = 0.06
"""Depth below which it does."""
_FACING = 0.0
"""Cosine of the angle between two normals below which their surfaces face each other."""
_STEPS = 20
"""Largest number of corrections."""
_SPREADS = 2
"""Rings of neighbours that take part in each correction."""
JOINED = 1.7
"""Lips or lids count as joined if the path from one to the other is shorter than this multiple of the straight
distance. Around a corner of the mouth it is longer."""


@dataclass(frozen=True)
class _Slit:
    """A slit.

    Attributes
    ----------
    sides : two arrays of intp
        Vertices above and below it.
    triangles : (T, 3) intp
        Triangles near it.
    crossing : int
        Number of pairs of triangles that cross at rest.
    gap : float
        Distance kept between the sides, in the unit of the mesh.
    attempts : tuple of (int, float)
        As `_LID_ATTEMPTS`.
    """

    sides: tuple[NDArray[np.intp], NDArray[np.intp]]
    triangles: NDArray[np.intp]
    crossing: int
    gap: float
    attempts: tuple[tuple[int, float], ...]


class SlitContact:
    """Keeps the skin above a slit of the mouth or an eye from passing through the skin below it.

    Parameters
    ----------
    rest : (V, 3) array
        Vertices at rest.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    landmarks, region_weights : (66,), (3, V) array
        As in `HeadRig`.

    Notes
    -----
    A vertex is too deep if it lies behind the plane through a nearby vertex across the slit that faces it, and did not
    at rest. Both are then moved apart along the normal of that plane, and their neighbours by a share of that.
    """

    def __init__(self, rest: FloatArray, faces: IntArray, landmarks: IntArray, region_weights: FloatArray) -> None:
        places, weights = np.asarray(rest, dtype=np.float64), np.asarray(region_weights)
        self._unit = outer_eye_distance(places[landmarks])
        region = np.where(weights.any(axis=0), weights.argmax(axis=0), -1)
        sides = []
        for organ, above, *_ in _SLITS:
            _, squared = NearestPoints(places[landmarks[organ]]).query(places)
            near = squared[:, 0] < (_REACH * self._unit) ** 2
            sides.append([np.flatnonzero(near & (region == side)) for side in (above, above + 1)])
        # Number the vertices of the slits and of the adjoining faces from 0.
        within = np.zeros(len(places) + 1, dtype=bool)
        within[np.concatenate([rows for pair in sides for rows in pair])] = True
        own = np.asarray(faces)[within[np.asarray(faces)].any(axis=1)]
        within[own[own >= 0]] = True
        self._rows = np.flatnonzero(within[:-1])
        number = np.full(len(within), -1)
        number[self._rows] = np.arange(len(self._rows))
        self._faces = number[own]
        self._rest = places[self._rows]
        self._normals = surface_normals(self._rest, self._faces)
        self._edges = _edges(self._faces)
        self._degree = np.maximum(np.bincount(self._edges[:, 0], minlength=len(self._rows)), 1)
        self._slits = [
            self._slit((number[upper], number[lower]), gap * self._unit, attempts)
            for (upper, lower), (_, _, gap, attempts) in zip(sides, _SLITS, strict=True)
            if len(upper) and len(lower)
        ]

    def _slit(
        self, sides: tuple[NDArray[np.intp], NDArray[np.intp]], gap: float, attempts: tuple[tuple[int, float], ...]
    ) -> _Slit:
        near = np.isin(np.arange(len(self._rest)), np.concatenate(sides))
        triangles = triangulate(self._faces)
        triangles = triangles[near[triangles].any(axis=1)]
        return _Slit(sides, triangles, len(crossing_pairs(self._rest, triangles)), gap, attempts)

    def resolve(self, vertices: NDArray[np.float32]) -> None:
        """Separate skin that has passed through a slit, in place: `vertices`, (V, 3) float32."""
        posed = vertices[self._rows].astype(np.float64)
        for slit in self._slits:
            posed = self._parted(slit, posed)
        vertices[self._rows] = posed

    def _parted(self, slit: _Slit, posed: FloatArray) -> FloatArray:
        """Return `posed` (N, 3) with the sides of a slit apart, by the attempt that leaves the fewest crossings."""
        if not self._pushes(slit, posed, *self._scaled(slit.attempts[0])).any():
            return posed
        best, least = posed, len(crossing_pairs(posed, slit.triangles))
        for attempt in slit.attempts:
            if least <= slit.crossing:
                break
            tried = self._pushed_apart(slit, posed, *self._scaled(attempt))
            if (crossing := len(crossing_pairs(tried, slit.triangles))) < least:
                best, least = tried, crossing
        return best

    def _scaled(self, attempt: tuple[int, float]) -> tuple[int, float]:
        return attempt[0], attempt[1] * self._unit

    def _pushed_apart(self, slit: _Slit, posed: FloatArray, neighbours: int, lateral: float) -> FloatArray:
        for _ in range(_STEPS):
            push = self._pushes(slit, posed, neighbours, lateral)
            if not push.any():
                break
            posed = posed + self._spread(push)
        return posed

    def _pushes(self, slit: _Slit, posed: FloatArray, neighbours: int, lateral: float) -> FloatArray:
        """Mean of the displacements that each vertex needs, (N, 3)."""
        normals = surface_normals(posed, self._faces)
        total, count = np.zeros_like(posed), np.zeros(len(posed))
        for own, other in (slit.sides, slit.sides[::-1]):
            found, squared = NearestPoints(posed[other]).query(posed[own], min(neighbours, len(other)))
            mine, facing = np.repeat(own, found.shape[1]), other[found.reshape(-1)]
            depth = ((posed[mine] - posed[facing]) * normals[facing]).sum(axis=1)
            needed = self._needed((mine, facing), depth, normals, slit.gap)
            # d^2 - depth^2 is the squared distance along the plane.
            deep = (needed > 0.0) & (squared.reshape(-1) - depth**2 < lateral**2)
            step = 0.5 * needed[deep, None] * normals[facing[deep]]
            for rows, moved in ((mine[deep], step), (facing[deep], -step)):
                np.add.at(total, rows, moved)
                np.add.at(count, rows, 1.0)
        return np.asarray(total / np.maximum(count, 1.0)[:, None])

    def _needed(
        self, pairs: tuple[IntArray, IntArray], depth: FloatArray, normals: FloatArray, gap: float
    ) -> FloatArray:
        """Distance that the first vertex of each pair lacks along the normal of the second, (P,); 0 on its own side."""
        mine, facing = pairs
        # At rest the vertex stood `before` in front of the plane; it may come as close as the gap, but not closer than
        # it was.
        before = ((self._rest[mine] - self._rest[facing]) * self._normals[facing]).sum(axis=1)
        lacking = np.minimum(gap, before) - depth
        # Planes hold only nearby: a vertex far behind one has not passed through the slit but is elsewhere on the face.
        passed = (lacking > _MIN_DEPTH * self._unit) & (lacking < _MAX_DEPTH * self._unit)
        passed &= (normals[mine] * normals[facing]).sum(axis=1) < _FACING
        return np.where(passed, lacking, 0.0)

    def _spread(self, push: FloatArray) -> FloatArray:
        """Extend `push` to vertices that are not pushed, by the mean of their neighbours."""
        pushed, spread = push.any(axis=1)[:, None], push
        first, second = self._edges.T
        for _ in range(_SPREADS):
            sums = [np.bincount(first, spread[second, i], len(push)) for i in range(3)]
            spread = np.where(pushed, push, np.stack(sums, axis=1) / self._degree[:, None])
        return spread


def _edges(faces: IntArray) -> NDArray[np.intp]:
    """Edges of faces padded with -1, in both directions, (E, 2)."""
    following = np.roll(faces, -1, axis=1)
    following = np.where(following < 0, faces[:, :1], following)
    pairs = np.stack([faces, following], axis=-1)[faces >= 0]
    return np.asarray(np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0), dtype=np.intp)


def lip_line(graph: SurfaceGraph, landmarks: IntArray) -> NDArray[np.intp]:
    """Find a line of edges between the lips, from the right corner of the mouth to the left one, as vertices (N,).

    Raises HeadError if no line of edges leads along the skin from corner to corner, or it has too few vertices.
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
    """Select the points of a line (N, 3) nearest to S ascending shares of its length: different ones, and no ends.

    There must be at least S + 2 points.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), 1e-12)
    chosen = np.array([int(np.argmin(np.abs(along[1:-1] - share))) + 1 for share in shares])
    # On uneven edges two shares may select the same vertex; move on to the next, for which the line has room.
    for i in range(1, len(chosen)):
        chosen[i] = max(chosen[i], chosen[i - 1] + 1)
    return np.minimum(chosen, len(points) - 1 - len(chosen) + np.arange(len(chosen)))


def lips_joined(graph: SurfaceGraph, landmarks: IntArray) -> bool:
    """Return whether the lips are one skin, that is, whether the path along the surface from lip to lip is short.

    Paths are measured between the outer rims of the lips, whose landmarks are away from any slit. Around a mouth that
    is wide open they are hardly longer than the way across, and lips that are apart are not one skin.
    """
    upper, lower = landmarks[UPPER_LIP[1:4]], landmarks[LOWER_LIP[1:4]]
    across = np.linalg.norm(graph.vertices[upper] - graph.vertices[lower], axis=1)
    apart = graph.vertices[landmarks[UPPER_LIPS]] - graph.vertices[landmarks[LOWER_LIPS]]
    if np.linalg.norm(apart, axis=1).max() > _GAPING * float(across.max()):
        return False
    width = float(np.linalg.norm(np.subtract(*graph.vertices[landmarks[MOUTH_CORNERS]])))
    lengths = [graph.path_lengths([int(u)], 2.0 * width)[v] for u, v in zip(upper, lower, strict=True)]
    return bool((np.array(lengths) < JOINED * across).any())
