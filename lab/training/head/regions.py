"""The three regions as weights: cut through the slits of eyes and mouth, fading out towards what must stay still.

Across a slit the change is sharp, lid from lid and lip from lip, inner rims included. Beyond the corners the regions
overlap along the lines on which the muscles meet: from the outer corner of the eye to the temple, over the bridge of
the nose, and from the corner of the mouth down to the angle of the jaw (method.md, section 5.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from facemime.core.base.landmarks import from_ibug, outer_eye_distance
from facemime.core.heads.regions import hold_landmarks

from . import anatomy
from .cut import CAVITY
from .surface import Surface

_EYE_SOFTNESS, _MOUTH_SOFTNESS = 0.0070, 0.0190


def region_weights(
    surface: Surface, vertices: NDArray[np.float64], landmarks: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Weights of upper, middle and lower, (3, V); `vertices` (V, 3) in the head frame, `landmarks` (66,)."""
    points = vertices[landmarks]
    x, y = np.abs(vertices[:, 0]), vertices[:, 1]
    above_eyes = _above(x, y, _eye_line(points), _eye_softness(x, points))
    above_mouth = _above(x, y, _mouth_line(points), _mouth_softness(x, points))
    lips = _near_lips(surface, vertices, points)
    nearer_upper = _nearer_upper_lip(surface, vertices)
    above_mouth[lips] = np.where(np.abs(nearer_upper[lips]) < 1e-9, 0.5, nearer_upper[lips] > 0)
    stays = 1.0 - _fade(surface, vertices, points)
    upper = above_eyes
    middle = (1.0 - above_eyes) * above_mouth
    lower = (1.0 - above_eyes) * (1.0 - above_mouth)
    weights = np.stack([upper, middle, lower]) * (1.0 - stays)
    weights[weights < 0.01] = 0.0
    return hold_landmarks(weights, vertices, landmarks)


def smooth_step(value: NDArray[np.float64], start: float, end: float) -> NDArray[np.float64]:
    """Smooth step from 0 at `start` to 1 at `end`; `start` may be the larger."""
    t = np.clip((value - start) / (end - start), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


Line = tuple[NDArray[np.float64], NDArray[np.float64]]


def _above(
    x: NDArray[np.float64], y: NDArray[np.float64], line: Line, soft: NDArray[np.float64]
) -> NDArray[np.float64]:
    """1 above the line (y is down), 0 below, with a transition of `soft` on either side."""
    t = np.clip(0.5 + (np.interp(x, *line) - y) / (2.0 * soft), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _eye_line(points: NDArray[np.float64]) -> Line:
    """From the bridge of the nose through both corners of the eye to the temple, for x >= 0."""
    bridge = points[from_ibug([27, 28]), 1].mean()
    inner, outer = points[from_ibug([42, 45])]
    return np.array([0.0, inner[0], outer[0], 0.1]), np.array([bridge, inner[1], outer[1], outer[1] - 0.002])


def _mouth_line(points: NDArray[np.float64]) -> Line:
    """From the corner of the mouth to the jaw line between landmarks 12 and 13, for x >= 0."""
    corner = points[from_ibug([54])[0]]
    angle = points[from_ibug([12, 13])].mean(axis=0)
    return np.array([0.0, corner[0], angle[0], 0.1]), np.array([corner[1], corner[1], angle[1], angle[1] + 0.002])


def _eye_softness(x: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    inner, outer = points[from_ibug([42, 45]), 0]
    outside = np.maximum.reduce([inner - x, x - outer, np.zeros_like(x)])
    return np.clip(outside * 0.8, 0.0002, _EYE_SOFTNESS)


def _mouth_softness(x: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.clip((x - points[from_ibug([54])[0], 0]) * 1.2, 0.0002, _MOUTH_SOFTNESS)


def _near_lips(surface: Surface, vertices: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Vertices whose side the surface decides rather than height: lips, their rims, the inside of the mouth."""
    corner, top, bottom = points[from_ibug([54, 51, 57])]
    box = (np.abs(vertices[:, 0]) <= corner[0] + 1e-6) & (vertices[:, 1] > top[1]) & (vertices[:, 1] < bottom[1])
    return box | _cavity(surface)


def _cavity(surface: Surface) -> NDArray[np.bool_]:
    inside = np.zeros(len(surface.share), dtype=bool)
    corner_in = (surface.token_chart[surface.tokens] == CAVITY) & (surface.faces >= 0)
    inside[surface.faces[corner_in]] = True
    return inside


def _nearer_upper_lip(surface: Surface, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Path length along the surface to the lower lip minus that to the upper, in metres: positive on the upper lip."""
    upper = _both_sides(surface, (*anatomy.UPPER_LIP_LINE, *anatomy.UPPER_LIP_INSIDE, *anatomy.UPPER_LIP_BORDER))
    lower = _both_sides(surface, (*anatomy.LOWER_LIP_LINE, *anatomy.LOWER_LIP_INSIDE, *anatomy.LOWER_LIP_BORDER))
    return _way(surface, vertices, lower) - _way(surface, vertices, upper)


def _both_sides(surface: Surface, native: tuple[int, ...]) -> NDArray[np.int64]:
    left = surface.vertex_of(np.array(native))
    return np.union1d(left, surface.mirror[left])


def _way(surface: Surface, vertices: NDArray[np.float64], seeds: NDArray[np.int64]) -> NDArray[np.float64]:
    """Length of the shortest path along edges to any of `seeds`, (V,), in metres."""
    faces = surface.faces
    count = (faces >= 0).sum(axis=1)
    edges = np.concatenate([np.c_[faces[i, :n], np.roll(faces[i, :n], -1)] for i, n in enumerate(count)])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = coo_matrix((length, (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    return np.asarray(dijkstra(graph, directed=False, indices=seeds, min_only=True))


def _fade(surface: Surface, vertices: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 on the face and inside the mouth, 0 on skull, ears and the neck's cut."""
    x, y, z = vertices.T
    tragus, unit = points[0], outer_eye_distance(points)
    brow = points[from_ibug(range(17, 27)), 1].min()
    side = smooth_step(z, tragus[2] + 0.3 * unit, tragus[2] - 0.15 * unit)
    scalp = smooth_step(y, brow - 0.062, brow - 0.026)
    throat = smooth_step(y + 0.25 * (z - points[8, 2]), points[8, 1] + 0.65 * unit, points[8, 1] + 0.2 * unit)
    ears = np.abs(x) < np.abs(tragus[0]) + 0.004
    return np.where(_cavity(surface), 1.0, side * scalp * throat * ears)
