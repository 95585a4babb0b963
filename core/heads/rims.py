"""The rims of the eyes and of the mouth, along which lids and lips meet (method.md, section 5.5)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import EYE_LEFT, EYE_RIGHT, LOWER_LIPS, MOUTH_CORNERS, UPPER_LIPS, outer_eye_distance
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Slit:
    """An eye or the mouth: the landmarks of its upper and lower rim, from corner to corner.

    If an opening between them is at rest smaller than `least`, in outer-eye distances, it is modelled shut. `fixed` are
    the indices of landmarks that are the same on every face, such as corners; those between them are not. Beside a
    corner, both rims may coincide up to the share `shared` of the way to the next landmark.
    """

    upper: NDArray[np.intp]
    lower: NDArray[np.intp]
    fixed: tuple[int, ...]
    least: float = 0.0
    shared: float = 0.0

    @property
    def between(self) -> NDArray[np.intp]:
        """Landmarks that are not fixed."""
        return np.concatenate([np.delete(line, self.fixed) for line in (self.upper, self.lower)])


EYES = tuple(Slit(eye[:4], eye[[0, 5, 4, 3]], fixed=(0, 3), least=0.01) for eye in (EYE_RIGHT, EYE_LEFT))
_UPPER, _LOWER = (np.insert(MOUTH_CORNERS, 1, lip) for lip in (UPPER_LIPS, LOWER_LIPS))
MOUTH = Slit(_UPPER, _LOWER, fixed=(0, 2, 4), shared=0.3)
_SLITS = (*EYES, MOUTH)
_NEAR = 0.15
"""Margin around the landmarks of an eye or the mouth, in outer-eye distances, within which its rims are sought."""
_STEPS = 12
"""Number of equal lengths into which the places of `rim_places` divide a rim. On four heads, carried keys are up to two
fifths nearer to the known head's along the rims than with half as many; twice as many gain less."""
N_RIM_PLACES = sum(2 * (_STEPS + 1 - len(slit.fixed)) for slit in _SLITS)
_DETOUR = 2.0
"""Length of a path between two landmarks, relative to their distance, above which it does not follow a rim."""


@dataclass(frozen=True)
class Rim:
    """A rim from corner to corner.

    Attributes
    ----------
    vertices : (N,) intp
        Its vertices.
    at : (N,) float64
        Their positions along it: 0 at the first corner, 1, 2 and so on at the landmarks.
    """

    vertices: NDArray[np.intp]
    at: FloatArray


def rims_of(places: FloatArray, faces: IntArray, landmarks: IntArray, slit: Slit) -> tuple[Rim, Rim] | None:
    """Find the upper and the lower rim of a slit; None if they are joined, modelled shut, or lead elsewhere.

    Arrays are as in `HeadRig`, in any frame.
    """
    points = places[landmarks]
    unit = outer_eye_distance(points)
    apart = np.linalg.norm((points[slit.lower] - points[slit.upper])[1:-1], axis=1)
    if apart.min() < slit.least * unit:
        return None
    about = points[np.concatenate([slit.upper, slit.lower])]
    inside = (places > about.min(axis=0) - _NEAR * unit) & (places < about.max(axis=0) + _NEAR * unit)
    near = np.flatnonzero(inside.all(axis=1))
    # The graph of the skin nearby, whose vertices are numbered from 0.
    own = np.full(len(places) + 1, -1)
    own[near] = np.arange(len(near))
    numbers = own[faces]
    graph = SurfaceGraph(places[near], numbers[((numbers >= 0) | (faces < 0)).all(axis=1)])
    above, below = (_rim(graph, own[landmarks[line]], near) for line in (slit.upper, slit.lower))
    if above is None or below is None:
        return None
    middle = (above.at > slit.shared) & (above.at < above.at[-1] - slit.shared)
    return None if np.isin(above.vertices[middle], below.vertices).any() else (above, below)


def rim_places(vertices: FloatArray, faces: IntArray | None, landmarks: IntArray) -> FloatArray:
    """Return places along all rims, (64, 3), in the frame of the vertices; NaN for slits without rims.

    They divide each rim between its fixed landmarks into equal lengths, so that they correspond on all heads. Arrays
    are as in `HeadRig`.
    """
    places, found = np.asarray(vertices, dtype=np.float64), []
    for slit in _SLITS:
        rims = None if faces is None else rims_of(places, np.asarray(faces), landmarks, slit)
        lines = None if rims is None else [_divided(places, rim, slit.fixed) for rim in rims]
        unknown = np.full((2 * (_STEPS + 1 - len(slit.fixed)), 3), np.nan)
        found.append(unknown if lines is None else np.concatenate(lines))
    return np.concatenate(found)


def corresponding(
    one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return places that correspond on two heads, two arrays (P, 3), from the landmarks (66, 3) and rims of each.

    Where both have the rims of a slit, these replace its landmarks that are not fixed.
    """
    kept, known, start = np.ones(len(one[0]), dtype=np.bool_), [], 0
    for slit in _SLITS:
        rows = np.arange(start, start := start + 2 * (_STEPS + 1 - len(slit.fixed)))
        if np.isfinite(one[1][rows]).all() and np.isfinite(other[1][rows]).all():
            kept[slit.between] = False
            known.append(rows)
    rows = np.concatenate(known) if known else np.empty(0, dtype=np.intp)
    first, second = (np.concatenate([landmarks[kept], rims[rows]]) for landmarks, rims in (one, other))
    return first, second


def _divided(places: FloatArray, rim: Rim, fixed: tuple[int, ...]) -> FloatArray:
    """Places that divide a rim between its fixed landmarks into equal lengths, without these."""
    line = places[rim.vertices]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    ends, steps = np.interp(fixed, rim.at, along), _STEPS // (len(fixed) - 1)
    at = [first + (last - first) * k / steps for first, last in pairwise(ends) for k in range(1, steps)]
    return np.stack([np.interp(at, along, line[:, axis]) for axis in range(3)], axis=1)


def _rim(graph: SurfaceGraph, ends: NDArray[np.intp], number: NDArray[np.intp]) -> Rim | None:
    """Find the path through landmarks at `ends` of a graph; None if it makes a detour.

    Its vertices have a `number` on the mesh.
    """
    rim, at = [int(ends[0])], [0.0]
    for section in range(len(ends) - 1):
        path = graph.path(int(ends[section]), int(ends[section + 1]))
        line = graph.vertices[path]
        along = np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))
        if len(along) and along[-1] > _DETOUR * np.linalg.norm(line[-1] - line[0]):
            return None
        rim += path[1:]
        at += (section + along / max(float(along[-1]) if len(along) else 0.0, 1e-12)).tolist()
    return Rim(number[np.array(rim)], np.array(at))
