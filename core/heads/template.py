"""The built-in head's skin laid over another mesh: turned and sized, then bent until the two agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..errors import HeadError
from ..landmarks import (
    EYE_LEFT,
    EYE_RIGHT,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    MOUTH_OUTER,
    N_LANDMARKS,
    outer_eye_distance,
)
from ..mesh.nearest import NearestPoints
from ..mesh.warp import Warp
from ..rotation import euler_to_matrix, fit_rotation
from .built_in import load_head

_SCALES = (0.8, 1.0, 1.25)
_HEIGHTS = (-0.35, -0.15, 0.05, 0.25)
"""First guesses where nothing is marked: size over the mesh's width, height of the eyes over its own height."""
_ATTITUDES = tuple(
    euler_to_matrix(*np.radians(angles))
    for angles in (
        (0, 0, 0),
        (0, 180, 0),
        (-90, 0, 0),
        (90, 0, 0),
        (0, 90, 0),
        (0, -90, 0),
        (0, 0, 180),
        (0, 0, 90),
        (0, 0, -90),
    )
)
"""How a mesh may have been left: to the viewer, to the back, on back or face, to a side, on the crown, on an ear."""
_LITTLE_STRAIN = 0.045
"""Bending, in outer-eye distances, below which an attitude is right beyond doubt: heads of other people and families
take 0.02 to 0.035, wrong attitudes 0.05 and more."""
_BODY = 2.6
"""Height over the smallest extent above which a mesh is not a head alone."""
_HEADS = (1.0 / 6.0, 1.0 / 4.0, 0.4)
"""How much of a body's height the head and neck may be: of a grown-up, a child, a comic figure."""
_ABOUT_MARKS = 3.0
"""Reach of the head about the marks' centre, in distances of the outermost mark."""
_RIGID_STEPS = 25
_SMOOTHINGS = (1.0, 0.3, 0.1)
_FEWEST = 5
"""Points that a bend in space needs at least; four fix its affine part."""
_LEFT_OUT = (
    (np.concatenate([EYE_RIGHT, EYE_LEFT]), 0.12),
    (np.concatenate([MOUTH_OUTER, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER]), 0.06),
)
"""Outer-eye distances from lids and lips within which the warps follow nothing: of a scan's eyes and mouth, which are
one skin with what is about them, the nearest places are others' as often as not. What lies around carries them."""
_AROUND = 0.3
"""Outer-eye distances that count as around a lid or lip."""
_SAMPLES = 900

Pose = tuple[float, FloatArray, FloatArray]
"""Scale, rotation and translation of the template: s R x + t."""


class Template:
    """The built-in head's skin, outer-eye distances, and the part of it that the warps follow."""

    def __init__(self) -> None:
        head = load_head()
        points = head.vertices[head.landmarks].astype(np.float64)
        unit = outer_eye_distance(points)
        self.places = (head.vertices - points.mean(axis=0)) / unit
        self.faces: IntArray = head.faces
        self.landmarks: IntArray = head.landmarks
        self.normals = surface_normals(self.places, head.faces)
        outside = (head.regions.sum(axis=0) > 0.5) & (self.normals[:, 2] < 0.2)
        for part, apart in _LEFT_OUT:
            marks = self.places[self.landmarks[part]]
            outside &= np.linalg.norm(self.places[:, None] - marks, axis=2).min(axis=1) > apart
        self.skin = np.flatnonzero(outside)[:: max(1, int(outside.sum()) // _SAMPLES)]

    def outlook(self, bent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(66, 3) each: which way the landmarks look on the bent vertices, and lids and lips with what lies around."""
        normals = surface_normals(bent, self.faces)
        own = normals[self.landmarks]
        around = own.copy()
        for part, _ in _LEFT_OUT:
            away = np.linalg.norm(self.places[self.landmarks[part], None] - self.places[self.skin], axis=2)
            total = (away < _AROUND).astype(np.float64) @ normals[self.skin]
            around[part] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
        return own, around


class Surface:
    """A mesh to be followed: the nearest vertex that faces the same way."""

    def __init__(self, places: FloatArray, faces: IntArray) -> None:
        self.places, self.faces, self.normals = places, faces, surface_normals(places, faces)
        self._weight = 0.15 * float(np.ptp(places, axis=0).min())
        self._points = NearestPoints(self._key(places, self.normals))

    def nearest(self, places: FloatArray, normals: FloatArray) -> NDArray[np.intp]:
        """(N,) vertices."""
        found, _ = self._points.query(self._key(places, normals))
        return found[:, 0]

    def _key(self, places: FloatArray, normals: FloatArray) -> FloatArray:
        return np.concatenate([places, self._weight * normals], axis=1)


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


@dataclass(frozen=True)
class Laid:
    """The template on a mesh.

    Attributes
    ----------
    attitude : (3, 3) float64
        By which the mesh was turned first.
    part : (P,) intp
        Vertices of the mesh that were taken for its head.
    marks : mapping
        Landmark to vertex of that part.
    surface : Surface
        That part, so turned.
    pose : Pose
    bent : (T, 3) float64
        The template's vertices.
    residual, strain : float
        Median distance that is left; mean distance of the bent landmarks from where a similarity would bring them.
        Outer-eye distances.
    """

    attitude: FloatArray
    part: NDArray[np.intp]
    marks: Mapping[int, int]
    surface: Surface
    pose: Pose
    bent: FloatArray
    residual: float
    strain: float


def lay_over(template: Template, places: FloatArray, faces: IntArray, picked: Mapping[int, int]) -> Laid:
    """The template over the mesh or its head, without marks in that attitude in which it has to be bent least.

    Raises
    ------
    HeadError
        If nothing of the mesh lies where the template's skin is, in any attitude.
    """
    best: Laid | None = None
    for attitude in _ATTITUDES[:1] if picked else _ATTITUDES:
        turned = places @ attitude.T
        for part in _heads_of(turned, picked):
            numbers = np.full(len(places) + 1, -1)
            numbers[part] = np.arange(len(part))
            within = (numbers[faces] >= 0) | (faces < 0)
            surface = Surface(turned[part], numbers[faces[within.all(axis=1)]])
            marks = {landmark: int(numbers[vertex]) for landmark, vertex in picked.items()}
            laid = _laid(template, surface, marks, part, attitude)
            if best is None or laid.strain < best.strain:
                best = laid
            if best.strain < _LITTLE_STRAIN:
                return best
    if best is None or not np.isfinite(best.strain):
        raise HeadError("No face was found on the mesh. Mark the corners of eyes and mouth, nose and chin.")
    return best


def _laid(
    template: Template, surface: Surface, marks: Mapping[int, int], part: NDArray[np.intp], attitude: FloatArray
) -> Laid:
    pose = _pose_from_marks(template, surface.places, marks) if marks else _pose_from_shape(template, surface)
    bent, residual = _bend(template, surface, pose, marks)
    strain = _strain(template, bent) if np.isfinite(residual) else np.inf
    return Laid(attitude, part, marks, surface, pose, bent, residual / pose[0], strain)


def _heads_of(places: FloatArray, picked: Mapping[int, int]) -> list[NDArray[np.intp]]:
    """Vertices that may be the head's: about the marks; all, or the top of what is as tall as a body."""
    if picked:
        marks = places[list(picked.values())]
        centre = marks.mean(axis=0)
        reach = _ABOUT_MARKS * float(np.linalg.norm(marks - centre, axis=1).max())
        return [np.flatnonzero(np.linalg.norm(places - centre, axis=1) < reach)]
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    if extent[1] < _BODY * extent.min():
        return [np.arange(len(places))]
    tops = [np.flatnonzero(places[:, 1] < low[1] + share * extent[1]) for share in _HEADS]
    return [top for top in tops if len(top) > N_LANDMARKS]


def _strain(template: Template, bent: FloatArray) -> float:
    """Mean distance of the bent template's landmarks from where a similarity would bring them, outer-eye distances."""
    source, target = template.places[template.landmarks], bent[template.landmarks]
    size, rotation, shift = _similarity(source, target)
    away = np.linalg.norm(size * source @ rotation.T + shift - target, axis=1)
    return float(away.mean()) / size


def _pose_from_marks(template: Template, places: FloatArray, picked: Mapping[int, int]) -> Pose:
    return _similarity(template.places[template.landmarks[list(picked)]], places[list(picked.values())])


def _pose_from_shape(template: Template, surface: Surface) -> Pose:
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


def _follow(template: Template, surface: Surface, pose: Pose, skin: NDArray[np.intp]) -> tuple[float, Pose]:
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


def _bend(template: Template, surface: Surface, pose: Pose, picked: Mapping[int, int]) -> tuple[FloatArray, float]:
    """The template's vertices on the mesh, and the median distance that is left: infinite if the mesh is elsewhere."""
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
            if np.count_nonzero(near) + len(own) < _FEWEST:
                return bent, np.inf
            source = np.concatenate([rest[template.skin][near], rest[own]])
            target = np.concatenate([goal[near], surface.places[list(picked.values())]])
            bent = Warp(source, target, 0.05 * smoothing)(rest)
    return bent, float(np.median(distance))
