"""Landmarks on a head that nobody has labelled: a template is laid over it and bent until the two agree.

The user marks a few points (eye corners, nose tip, mouth corners, chin), or none where the mesh stands upright and
faces the viewer. The built-in head is the template: its skin follows the mesh through ever more flexible warps, each
to the nearest places that face the same way, and its 66 landmarks end on the vertices next to them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray, as_points
from ..errors import HeadError
from ..head import load_head
from ..landmarks import (
    EYE_LEFT,
    EYE_RIGHT,
    MIRROR,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    MOUTH_OUTER,
    N_LANDMARKS,
    from_ibug,
)
from ..rotation import fit_rotation
from .surface import SurfaceGraph
from .warp import Warp

MARKS = {36: "right eye, outer corner", 39: "right eye, inner corner", 42: "left eye, inner corner"} | {
    45: "left eye, outer corner",
    30: "tip of the nose",
    48: "right mouth corner",
    54: "left mouth corner",
    8: "chin",
}
"""The points that a user marks, by iBUG number: all or some of them, in any order."""
LEAST_MARKS = 4

_SCALES = (0.8, 1.0, 1.25)
_HEIGHTS = (-0.35, -0.15, 0.05, 0.25)
"""First guesses where nothing is marked: size over the mesh's width, height of the eyes over its own height."""
_RIGID_STEPS = 25
_SMOOTHINGS = (1.0, 0.3, 0.1)
_LEFT_OUT = (
    (np.concatenate([EYE_RIGHT, EYE_LEFT]), 0.12),
    (np.concatenate([MOUTH_OUTER, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER]), 0.06),
)
"""Outer-eye distances from lids and lips within which the warps follow nothing: of a scan's eyes and mouth, which are
one skin with what is about them, the nearest places are others' as often as not. What lies around carries them."""
_SAMPLES = 900
_RIMS = np.concatenate([EYE_RIGHT, EYE_LEFT, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
_RIM_REACH = 0.08
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
    symmetric : bool
        Whether the mesh is its own mirror image; then so are the landmarks.
    """

    landmarks: NDArray[np.intp]
    rotation: FloatArray
    residual: float
    symmetric: bool


def bind_landmarks(vertices: FloatArray, faces: IntArray, marks: Mapping[int, int] | None = None) -> Binding:
    """Find the 66 landmarks of a head.

    Parameters
    ----------
    vertices : (V, 3) array
        Any unit; the head frame (upright, facing the viewer) where nothing is marked, else any frame.
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
    template, surface = _Template(), _Surface(places, np.asarray(faces))
    pose = _pose_from_marks(template, places, picked) if picked else _pose_from_shape(template, surface)
    bent, residual = _bend(template, surface, pose, picked)
    landmarks = surface.nearest(bent[template.landmarks], surface_normals(bent, template.faces)[template.landmarks])
    graph = SurfaceGraph(places, np.asarray(faces))
    unit = pose[0]
    landmarks = _onto_rims(graph, bent[template.landmarks], landmarks, _RIM_REACH * unit)
    landmarks[list(picked)] = list(picked.values())
    mirror = _mirror(places, pose[1], places[landmarks], unit)
    if mirror is not None:
        landmarks = _symmetric(landmarks, mirror, places, bent[template.landmarks], picked)
    if len(set(landmarks.tolist())) < 0.8 * N_LANDMARKS:
        raise HeadError("No face was found on the mesh. Mark the corners of eyes and mouth, nose and chin.")
    return Binding(_distinct(graph, landmarks), pose[1].T, residual / unit, mirror is not None)


Pose = tuple[float, FloatArray, FloatArray]
"""Scale, rotation and translation of the template: s R x + t."""


class _Template:
    """The built-in head's skin, outer-eye distances, and the part of it that the warps follow."""

    def __init__(self) -> None:
        head = load_head()
        points = head.vertices[head.landmarks].astype(np.float64)
        unit = float(np.linalg.norm(np.subtract(*points[from_ibug((36, 45))])))
        self.places = (head.vertices - points.mean(axis=0)) / unit
        self.faces: IntArray = head.faces
        self.landmarks: IntArray = head.landmarks
        self.normals = surface_normals(self.places, head.faces)
        outside = (head.regions.sum(axis=0) > 0.5) & (self.normals[:, 2] < 0.2)
        for part, apart in _LEFT_OUT:
            marks = self.places[self.landmarks[part]]
            outside &= np.linalg.norm(self.places[:, None] - marks, axis=2).min(axis=1) > apart
        self.skin = np.flatnonzero(outside)[:: max(1, int(outside.sum()) // _SAMPLES)]


class _Surface:
    """A mesh to be followed: the nearest vertex that faces the same way."""

    def __init__(self, places: FloatArray, faces: IntArray) -> None:
        self.places, self.normals = places, surface_normals(places, faces)
        self._weight = 0.15 * float(np.ptp(places, axis=0).min())
        tree = {"algorithm": 4, "leaf_max_size": 10}
        self._index = cv2.flann_Index(self._key(places, self.normals), tree)  # type: ignore[attr-defined]

    def nearest(self, places: FloatArray, normals: FloatArray) -> NDArray[np.intp]:
        """(N,) vertices."""
        found, _ = self._index.knnSearch(self._key(places, normals), 1, params={"checks": -1})
        return np.asarray(found[:, 0], dtype=np.intp)

    def _key(self, places: FloatArray, normals: FloatArray) -> NDArray[np.float32]:
        return np.ascontiguousarray(np.concatenate([places, self._weight * normals], axis=1), dtype=np.float32)


def surface_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(V, 3) unit normals of the vertices, by the areas of their faces."""
    triangles = faces[:, :3]
    if faces.shape[1] > 3:
        triangles = np.concatenate([triangles, faces[faces[:, 3] >= 0][:, [0, 2, 3]]])
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(across[:, i], 3), len(vertices)) for i in range(3)], axis=1
    )
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))


def _pose_from_marks(template: _Template, places: FloatArray, picked: Mapping[int, int]) -> Pose:
    return _similarity(template.places[template.landmarks[list(picked)]], places[list(picked.values())])


def _pose_from_shape(template: _Template, surface: _Surface) -> Pose:
    """The similarity, among several starts, that leaves the template's skin nearest to the mesh."""
    low, high = surface.places.min(axis=0), surface.places.max(axis=0)
    skin = template.skin[::2]
    best: tuple[float, Pose] | None = None
    for scale in _SCALES:
        size = scale * float(high[0] - low[0]) / 2.0
        depth = float(np.percentile(surface.places[:, 2], 0.5)) - size * float(template.places[skin, 2].min())
        for height in _HEIGHTS:
            middle = (low + high) / 2.0
            start = np.array([middle[0], middle[1] + height * (high[1] - low[1]), depth])
            distance, pose = _follow(template, surface, (size, np.eye(3), start), skin)
            if best is None or distance < best[0]:
                best = (distance, pose)
    assert best is not None
    return best[1]


def _follow(template: _Template, surface: _Surface, pose: Pose, skin: NDArray[np.intp]) -> tuple[float, Pose]:
    """Iterated closest points from `pose`, the worst fifth left out; the mean distance in the template's unit."""
    for _ in range(_RIGID_STEPS):
        size, rotation, shift = pose
        placed = size * template.places[skin] @ rotation.T + shift
        goal = surface.places[surface.nearest(placed, template.normals[skin] @ rotation.T)]
        distance = np.linalg.norm(goal - placed, axis=1)
        kept = distance <= np.quantile(distance, 0.8)
        pose = _similarity(template.places[skin][kept], goal[kept])
    return float(np.minimum(distance / pose[0], 0.3).mean()), pose


def _similarity(source: FloatArray, target: FloatArray) -> Pose:
    """The similarity from (N, 3) source to target points (Umeyama 1991)."""
    from_centre, to_centre = source.mean(axis=0), target.mean(axis=0)
    a, b = source - from_centre, target - to_centre
    spread = np.linalg.svd(a, compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise HeadError("The marked points lie on one line. Mark eyes, nose and mouth.")
    rotation = fit_rotation(a, b)
    size = float((b * (a @ rotation.T)).sum() / (a * a).sum())
    if not size > 0.0:
        raise HeadError("The marked points do not look like a face. Mark them again, left and right as the head's own.")
    return size, rotation, np.asarray(to_centre - size * rotation @ from_centre)


def _bend(template: _Template, surface: _Surface, pose: Pose, picked: Mapping[int, int]) -> tuple[FloatArray, float]:
    """The template's vertices on the mesh, and the median distance that is left."""
    size, rotation, shift = pose
    rest = size * template.places @ rotation.T + shift
    bent = rest
    own = template.landmarks[list(picked)]
    for smoothing in _SMOOTHINGS:
        for _ in range(2):
            normals = surface_normals(bent, template.faces)
            goal = surface.places[surface.nearest(bent[template.skin], normals[template.skin])]
            distance = np.linalg.norm(goal - bent[template.skin], axis=1)
            near = distance < 0.15 * size
            source = np.concatenate([rest[template.skin][near], rest[own]])
            target = np.concatenate([goal[near], surface.places[list(picked.values())]])
            bent = Warp(source, target, 0.05 * smoothing)(rest)
    return bent, float(np.median(distance))


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


def _mirror(places: FloatArray, rotation: FloatArray, points: FloatArray, unit: float) -> NDArray[np.intp] | None:
    """(V,) vertex on the other side, where the mesh is its own mirror image across the face's middle; else None."""
    across = rotation[:, 0]
    axis = int(np.argmax(np.abs(across)))
    if abs(across[axis]) < 0.999:
        return None
    middle = float(np.median(((points + points[MIRROR]) / 2.0)[:, axis]))
    other = places.copy()
    for centre in (middle, 0.0):
        other[:, axis] = 2.0 * centre - places[:, axis]
        tree = {"algorithm": 4, "leaf_max_size": 10}
        index = cv2.flann_Index(places.astype(np.float32), tree)  # type: ignore[attr-defined]
        found, squared = index.knnSearch(other.astype(np.float32), 1, params={"checks": -1})
        if float((squared[:, 0] < (_SYMMETRY * unit) ** 2).mean()) > 0.95:
            return np.asarray(found[:, 0], dtype=np.intp)
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
