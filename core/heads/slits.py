"""Contact of lips with each other, and of lids (docs/method.md, section 9.6)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..landmarks import EYE_LEFT, EYE_RIGHT, LIPS, outer_eye_distance
from ..mesh.nearest import NearestPoints
from ..mesh.surface import surface_normals

_LIDS, _LIPS = (1, 0.002), (3, 0.003)
"""Nearest vertices across the slit that a vertex must not pass, as lids are too thin for more than one, and the
distance that both sides keep, or that at rest if it is less. All lengths are in outer-eye distances."""
_SLITS = ((EYE_RIGHT, 0, *_LIDS), (EYE_LEFT, 0, *_LIDS), (LIPS, 1, *_LIPS))
"""Landmarks of each slit, the region above it, which the next one is below, neighbours and distance."""
_REACH = 0.12
"""Distance from its landmarks within which skin belongs to a slit."""
_MIN_DEPTH, _MAX_DEPTH, _LATERAL = 1e-4, 0.06, 0.04
"""Depths between which a vertex has passed through a plane, and its distance along the plane from the vertex there."""
_FACING = 0.0
"""Cosine of the angle between two normals below which their surfaces face each other."""
_STEPS, _SPREADS = 20, 2
"""Corrections at most, and rings of neighbours that take part in each."""


@dataclass(frozen=True)
class _Slit:
    """Rows of the vertices above and below a slit, how many neighbours count, and the distance to keep."""

    sides: tuple[NDArray[np.intp], NDArray[np.intp]]
    neighbours: int
    gap: float


class SlitContact:
    """Keeps the skin above a slit, of the mouth or an eye, from passing through that below it.

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
    A vertex is too deep if it lies behind the plane through a nearest vertex across the slit that faces it, and did not
    at rest. Both are then moved apart along the normal of that plane, and their neighbours a share of that.
    """

    def __init__(self, rest: FloatArray, faces: IntArray, landmarks: IntArray, region_weights: FloatArray) -> None:
        places, weights = np.asarray(rest, dtype=np.float64), np.asarray(region_weights)
        points = places[landmarks]
        self._unit = outer_eye_distance(points)
        region = np.where(weights.any(axis=0), weights.argmax(axis=0), -1)
        slits = []
        for organ, above, neighbours, gap in _SLITS:
            _, squared = NearestPoints(points[organ]).query(places)
            near = squared[:, 0] < (_REACH * self._unit) ** 2
            upper, lower = (np.flatnonzero(near & (region == side)) for side in (above, above + 1))
            if len(upper) and len(lower):
                slits.append(_Slit((upper, lower), neighbours, gap * self._unit))
        self._compact(places, np.asarray(faces), slits)

    def _compact(self, places: FloatArray, faces: IntArray, slits: list[_Slit]) -> None:
        """Number the vertices of the slits and of the faces about them anew, from 0."""
        about = np.zeros(len(places) + 1, dtype=bool)
        for slit in slits:
            about[np.concatenate(slit.sides)] = True
        own = faces[about[faces].any(axis=1)]
        about[own[own >= 0]] = True
        about[-1] = False
        self._rows = np.flatnonzero(about)
        number = np.full(len(about), -1)
        number[self._rows] = np.arange(len(self._rows))
        self._faces = number[own]
        self._slits = [replace(s, sides=(number[s.sides[0]], number[s.sides[1]])) for s in slits]
        self._rest = places[self._rows]
        self._normals = surface_normals(self._rest, self._faces)
        self._edges = _edges(self._faces)
        self._degree = np.maximum(np.bincount(self._edges[:, 0], minlength=len(self._rows)), 1)

    def resolve(self, vertices: NDArray[np.float32]) -> None:
        """Move what has passed through apart, in place: (V, 3) float32."""
        if not self._slits:
            return
        posed = vertices[self._rows].astype(np.float64)
        for _ in range(_STEPS):
            push = self._pushes(posed)
            if not push.any():
                return
            posed += self._spread(push)
            vertices[self._rows] = posed

    def _pushes(self, posed: FloatArray) -> FloatArray:
        """(N, 3) mean of the displacements that each vertex needs."""
        normals = surface_normals(posed, self._faces)
        total, count = np.zeros_like(posed), np.zeros(len(posed))
        for slit in self._slits:
            for own, other in (slit.sides, slit.sides[::-1]):
                found, squared = NearestPoints(posed[other]).query(posed[own], min(slit.neighbours, len(other)))
                mine, facing = np.repeat(own, found.shape[1]), other[found.reshape(-1)]
                needed = self._needed(posed, normals, (mine, facing), squared.reshape(-1), slit.gap)
                deep = needed > 0.0
                step = 0.5 * needed[deep, None] * normals[facing[deep]]
                for rows, moved in ((mine[deep], step), (facing[deep], -step)):
                    np.add.at(total, rows, moved)
                    np.add.at(count, rows, 1.0)
        return np.asarray(total / np.maximum(count, 1.0)[:, None])

    def _needed(
        self, posed: FloatArray, normals: FloatArray, pairs: tuple[IntArray, IntArray], squared: FloatArray, gap: float
    ) -> FloatArray:
        """(P,) distance that the first of each pair lacks along the normal of the second; 0 if it is on its side."""
        mine, facing = pairs
        depth = ((posed[mine] - posed[facing]) * normals[facing]).sum(axis=1)
        before = ((self._rest[mine] - self._rest[facing]) * self._normals[facing]).sum(axis=1)
        lacking = np.minimum(gap, before) - depth
        passed = (lacking > _MIN_DEPTH * self._unit) & (lacking < _MAX_DEPTH * self._unit)
        passed &= squared - depth**2 < (_LATERAL * self._unit) ** 2
        passed &= (normals[mine] * normals[facing]).sum(axis=1) < _FACING
        return np.where(passed, lacking, 0.0)

    def _spread(self, push: FloatArray) -> FloatArray:
        """`push`, with the mean of their neighbours for vertices that are not pushed."""
        pushed, spread = push.any(axis=1)[:, None], push
        first, second = self._edges.T
        for _ in range(_SPREADS):
            sums = [np.bincount(first, spread[second, i], len(push)) for i in range(3)]
            spread = np.where(pushed, push, np.stack(sums, axis=1) / self._degree[:, None])
        return spread


def _edges(faces: IntArray) -> NDArray[np.intp]:
    """(E, 2) edges of faces padded with -1, in both directions."""
    following = np.roll(faces, -1, axis=1)
    following = np.where(following < 0, faces[:, :1], following)
    pairs = np.stack([faces, following], axis=-1)[faces >= 0]
    return np.asarray(np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0), dtype=np.intp)
