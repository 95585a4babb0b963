"""Landmarks on a head that nobody has labelled: a template is laid over it and bent until the two agree.

The user marks a few points (eye corners, nose tip, mouth corners, chin), or none where the mesh's axes are the head's;
a whole body will do.
The built-in head is the template: its skin follows the mesh through ever more flexible warps, each to the nearest
places that face the same way, and its 66 landmarks end on the vertices next to them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray, as_points
from ..errors import HeadError
from ..landmarks import (
    EYE_LEFT,
    EYE_RIGHT,
    LOWER_LIP,
    MIRROR,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    N_LANDMARKS,
    UPPER_LIP,
    from_ibug,
)
from ..mesh.nearest import NearestPoints
from ..mesh.surface import SurfaceGraph, lips_joined
from .template import Surface, Template, lay_over

MARKS = {36: "right eye, outer corner", 39: "right eye, inner corner", 42: "left eye, inner corner"} | {
    45: "left eye, outer corner",
    30: "tip of the nose",
    48: "right mouth corner",
    54: "left mouth corner",
    8: "chin",
}
"""The points that a user marks, by iBUG number: all or some of them, in any order."""
LEAST_MARKS = 4

_RIMS = np.concatenate([EYE_RIGHT, EYE_LEFT, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
"""The lips' outer rims between the corners."""
_RIM_REACH = 0.08
_HEAD_ALONE = 0.8
"""Share of a mesh's vertices that its head has, where it is little more than a head."""
_TOO_FAR = 0.1
"""Outer-eye distances beyond which a place is not a landmark's, though it faces the same way."""
_SYMMETRY = 1e-3


@dataclass(frozen=True)
class Binding:
    """Landmarks found on a mesh.

    Attributes
    ----------
    landmarks : (66,) intp
        Vertex of each landmark.
    rotation : (3, 3) float64
        Turns the mesh upright and towards the viewer: `vertices @ rotation.T` are in the head frame.
    residual : float
        Median distance of the bent template from the mesh, outer-eye distances.
    strain : float
        How far the template's landmarks had to be bent, outer-eye distances: 0.02 to 0.04 for a human head.
    symmetric : bool
        Whether the head is its own mirror image; then so are the landmarks.
    body : bool
        Whether the mesh has much more to it than a head.
    """

    landmarks: NDArray[np.intp]
    rotation: FloatArray
    residual: float
    strain: float
    symmetric: bool
    body: bool


def bind_landmarks(vertices: FloatArray, faces: IntArray, marks: Mapping[int, int] | None = None) -> Binding:
    """Find the 66 landmarks of a head.

    Parameters
    ----------
    vertices : (V, 3) array
        Any unit. Where nothing is marked, the head's axes are those of the mesh: upright and facing the viewer in the
        head frame, which is tried first and is quickest, to another side, or lying on back or face.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    marks : mapping, optional
        iBUG number of a landmark to the vertex that the user picked, at least four of `MARKS`.

    Raises
    ------
    HeadError
        Fewer than four marks, marks on one line, or a mesh on which no face was found.

    Notes
    -----
    Nearest places are sought among position and normal together, so that a lip is not taken for the inside of the
    mouth. A similarity first (Besl & McKay 1992), then biharmonic warps of falling smoothness (as in Amberg et al.
    2007), then lids and inner lips are moved to the openings' rims where the mesh has some. About a second for 100,000
    vertices.
    """
    places = as_points(vertices, "vertices", error=HeadError)
    picked = {int(from_ibug([number])[0]): int(vertex) for number, vertex in (marks or {}).items()}
    if picked and len(picked) < LEAST_MARKS:
        raise HeadError(f"Mark at least {LEAST_MARKS} points, or none; got {len(picked)}.")
    if picked and (min(picked.values()) < 0 or max(picked.values()) >= len(places)):
        raise HeadError("A marked point is no vertex of the mesh. Mark it again.")
    if len(places) < N_LANDMARKS:
        raise HeadError(f"The mesh has {len(places)} vertices; a head with {N_LANDMARKS} landmarks needs more.")
    template = Template()
    laid = lay_over(template, places, np.asarray(faces), picked)
    surface, (unit, rotation, _), bent, picked = laid.surface, laid.pose, laid.bent, dict(laid.marks)
    landmarks = _nearest(template, surface, bent, _TOO_FAR * unit)
    graph = SurfaceGraph(surface.places, surface.faces)
    landmarks = _onto_rims(graph, bent[template.landmarks], landmarks, _RIM_REACH * unit)
    landmarks[list(picked)] = list(picked.values())
    landmarks = _on_own_lip(graph, bent[template.landmarks], landmarks)
    mirror = _mirror(surface.places, rotation, surface.places[landmarks], unit)
    if mirror is not None:
        landmarks = _symmetric(landmarks, mirror, surface.places, bent[template.landmarks], picked)
        landmarks = _on_own_lip(graph, bent[template.landmarks], landmarks, mirror == np.arange(len(mirror)))
    if len(set(landmarks.tolist())) < 0.8 * N_LANDMARKS:
        raise HeadError("No face was found on the mesh. Mark the corners of eyes and mouth, nose and chin.")
    turn = rotation.T @ laid.attitude
    found = laid.part[_distinct(graph, landmarks)]
    body = len(laid.part) < _HEAD_ALONE * len(places)
    return Binding(found, turn, laid.residual, laid.strain, mirror is not None, body)


def _nearest(template: Template, surface: Surface, bent: FloatArray, reach: float) -> NDArray[np.intp]:
    """(66,) vertices nearest to the bent template's landmarks that face the same way.

    On lids and lips the same way is that of what lies around them, where there is nothing that way within `reach`: on a
    mesh without rims a rim's own way leads to the underside of something.
    """
    wanted = bent[template.landmarks]
    own, around = template.outlook(bent)
    found = surface.nearest(wanted, own)
    away = np.linalg.norm(surface.places[found] - wanted, axis=1) > reach
    found[away] = surface.nearest(wanted[away], around[away]) if away.any() else found[away]
    return found


def _onto_rims(graph: SurfaceGraph, wanted: FloatArray, landmarks: IntArray, reach: float) -> NDArray[np.intp]:
    """Lids and inner lips on the nearest border within `reach`, where the mesh has openings there."""
    moved = np.array(landmarks, dtype=np.intp)
    pieces = [piece for piece in graph.openings() if len(piece) < 0.5 * len(graph.vertices)]
    if not pieces:
        return moved
    border = np.concatenate(pieces)
    for i in _RIMS:
        distance = np.linalg.norm(graph.vertices[border] - wanted[i], axis=1)
        if distance.min() < reach:
            moved[i] = border[np.argmin(distance)]
    return moved


def _on_own_lip(
    graph: SurfaceGraph, wanted: FloatArray, landmarks: IntArray, middle: NDArray[np.bool_] | None = None
) -> NDArray[np.intp]:
    """Inner lips that were found on the other lip, which touches, on their own: the nearer one along the surface.

    The two in the middle of a symmetric head stay among the vertices `middle` (V,).
    """
    moved = np.array(landmarks, dtype=np.intp)
    if lips_joined(graph, landmarks):
        return moved
    to_upper, to_lower = (graph.ways(landmarks[rim].tolist()) for rim in (UPPER_LIP, LOWER_LIP))
    for inner, own, other in (
        (MOUTH_INNER_UPPER, to_upper, to_lower),
        (MOUTH_INNER_LOWER, to_lower, to_upper),
    ):
        for i in inner[own[moved[inner]] >= other[moved[inner]]]:
            within = own < other if middle is None or MIRROR[i] != i else (own < other) & middle
            if len(lip := np.flatnonzero(within)):
                moved[i] = lip[np.argmin(np.linalg.norm(graph.vertices[lip] - wanted[i], axis=1))]
    return moved


def _mirror(places: FloatArray, rotation: FloatArray, points: FloatArray, unit: float) -> NDArray[np.intp] | None:
    """(V,) vertex on the other side, where the mesh is its own mirror image across the face's middle; else None."""
    across = rotation[:, 0]
    axis = int(np.argmax(np.abs(across)))
    if abs(across[axis]) < 0.999:
        return None
    middle = float(np.median(((points + points[MIRROR]) / 2.0)[:, axis]))
    other, index = places.copy(), NearestPoints(places)
    for centre in (middle, 0.0):
        other[:, axis] = 2.0 * centre - places[:, axis]
        found, squared = index.query(other)
        if float((squared[:, 0] < (_SYMMETRY * unit) ** 2).mean()) > 0.95:
            return found[:, 0]
    return None


def _symmetric(
    landmarks: IntArray, mirror: NDArray[np.intp], places: FloatArray, wanted: FloatArray, picked: Mapping[int, int]
) -> NDArray[np.intp]:
    """Of each pair the side that lies nearer to where it should, and its mirror image; the middle on the middle."""
    even = np.array(landmarks, dtype=np.intp)
    middle = np.flatnonzero(mirror == np.arange(len(mirror)))
    off = np.linalg.norm(places[landmarks] - wanted, axis=1)
    off[list(picked)] = -1.0
    for i, j in enumerate(MIRROR.tolist()):
        if i == j and len(middle) and i not in picked:
            even[i] = middle[np.argmin(np.linalg.norm(places[middle] - wanted[i], axis=1))]
        elif i < j:
            better, other = (i, j) if off[i] <= off[j] else (j, i)
            if other not in picked:
                even[other] = mirror[landmarks[better]]
    return even


def _distinct(graph: SurfaceGraph, landmarks: IntArray) -> NDArray[np.intp]:
    """Landmarks that fell on one vertex spread to free neighbours: control points must differ."""
    spread, used = np.array(landmarks, dtype=np.intp), set()
    for i, vertex in enumerate(landmarks.tolist()):
        if vertex in used:
            free = [v for v in graph.neighbours(vertex) if v not in used]
            if not free:
                raise HeadError("The mesh is too coarse for 66 landmarks. Subdivide the face, or use another mesh.")
            spread[i] = min(free, key=lambda v: float(np.linalg.norm(graph.vertices[v] - graph.vertices[vertex])))
        used.add(int(spread[i]))
    return spread
