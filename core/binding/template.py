"""The built-in head as a template: aligned with another mesh, then bent to it (docs/method.md, section 7.1)."""

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
"""Starts of the alignment without marks: size over width of the mesh, and height of the eyes over its height."""
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
"""Attitudes of a mesh: towards the viewer, away, on back or face, to a side, upside down, on an ear."""
_LOW_STRAIN = 0.045
"""Strain in outer-eye distances below which an attitude is accepted: human heads take 0.02 to 0.035, wrong attitudes
0.05 and more."""
_BODY_RATIO = 2.6
"""Height over smallest extent above which a mesh is more than a head."""
_HEAD_SHARES = (1.0 / 6.0, 1.0 / 4.0, 0.4)
"""Share of a body's height that head and neck may have: of an adult, a child, a cartoon figure."""
_MARKS_REACH = 3.0
"""Reach of the head around the centre of the marks, in distances of the outermost mark."""
_RIGID_STEPS = 25
_SMOOTHINGS = (1.0, 0.3, 0.1)
"""Smoothness of successive warps, as a multiple of the smoothing of `_bend`."""
_MIN_POINTS = 5
"""Fewest points of a warp; four determine its affine part."""
_EXCLUDED = (
    (np.concatenate([EYE_RIGHT, EYE_LEFT]), 0.12),
    (np.concatenate([MOUTH_OUTER, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER]), 0.06),
)
"""Landmarks, and outer-eye distances from these within which the template does not follow the mesh. On a scan, whose
eyes and mouth are closed by skin, nearest places there are often wrong; the surrounding skin carries them."""
_AROUND = 0.3
"""Outer-eye distances that count as around a lid or lip."""
_SAMPLES = 900
"""Points of the template that follow the mesh."""

Pose = tuple[float, FloatArray, FloatArray]
"""Scale, rotation and translation of the template: ``s R x + t``."""


class Template:
    """The skin of the built-in head in outer-eye distances, and the points of it that follow the mesh."""

    def __init__(self) -> None:
        head = load_head()
        points = head.vertices[head.landmarks].astype(np.float64)
        unit = outer_eye_distance(points)
        self.places = (head.vertices - points.mean(axis=0)) / unit
        self.faces: IntArray = head.faces
        self.landmarks: IntArray = head.landmarks
        self.normals = surface_normals(self.places, head.faces)
        outside = (head.regions.sum(axis=0) > 0.5) & (self.normals[:, 2] < 0.2)
        for part, apart in _EXCLUDED:
            marks = self.places[self.landmarks[part]]
            outside &= np.linalg.norm(self.places[:, None] - marks, axis=2).min(axis=1) > apart
        self.skin = np.flatnonzero(outside)[:: max(1, int(outside.sum()) // _SAMPLES)]

    def landmark_normals(self, bent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(66, 3) normals of the landmarks on the bent vertices, and the same with those around lids and lips."""
        normals = surface_normals(bent, self.faces)
        own = normals[self.landmarks]
        around = own.copy()
        for part, _ in _EXCLUDED:
            away = np.linalg.norm(self.places[self.landmarks[part], None] - self.places[self.skin], axis=2)
            total = (away < _AROUND).astype(np.float64) @ normals[self.skin]
            around[part] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
        return own, around


class Surface:
    """A mesh that the template follows: finds nearest vertices that face the same way."""

    def __init__(self, places: FloatArray, faces: IntArray) -> None:
        self.places, self.faces, self.normals = places, faces, surface_normals(places, faces)
        # Opposite normals are as far apart as 0.3 of the smallest extent.
        self._weight = 0.15 * float(np.ptp(places, axis=0).min())
        self._points = NearestPoints(self._key(places, self.normals))

    def nearest(self, places: FloatArray, normals: FloatArray) -> NDArray[np.intp]:
        """Find nearest vertices that face the same way.

        Parameters
        ----------
        places : (N, 3) float64
            Positions.
        normals : (N, 3) float64
            Unit normals.

        Returns
        -------
        (N,) int
            Vertices.
        """
        found, _ = self._points.query(self._key(places, normals))
        return found[:, 0]

    def _key(self, places: FloatArray, normals: FloatArray) -> FloatArray:
        return np.concatenate([places, self._weight * normals], axis=1)


def surface_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals of vertices, weighted by the areas of their faces.

    Parameters
    ----------
    vertices : (V, 3) array
        Any frame and unit.
    faces : (F, 3) or (F, 4) array of int
        Vertices of each face, triangles padded with -1.

    Returns
    -------
    (V, 3) float64
        Normals; 0 for vertices without faces.
    """
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
class FittedTemplate:
    """The template, fitted to a mesh.

    Attributes
    ----------
    attitude : (3, 3) float64
        Rotation that was applied to the mesh first.
    part : (P,) intp
        Vertices of the mesh that belong to its head.
    marks : mapping
        Vertex of that part by landmark.
    surface : Surface
        That part, rotated.
    pose : Pose
        Alignment of the template.
    bent : (T, 3) float64
        Vertices of the bent template.
    residual : float
        Median distance to the mesh, in outer-eye distances.
    strain : float
        Mean distance of the bent landmarks from their best similarity, in outer-eye distances.
    """

    attitude: FloatArray
    part: NDArray[np.intp]
    marks: Mapping[int, int]
    surface: Surface
    pose: Pose
    bent: FloatArray
    residual: float
    strain: float


def fit_template(template: Template, places: FloatArray, faces: IntArray, picked: Mapping[int, int]) -> FittedTemplate:
    """Fit the template to a mesh or its head; without marks, in the attitude that bends it least.

    Parameters
    ----------
    template : Template
        The template.
    places : (V, 3) float64
        Vertices of the mesh.
    faces : (F, K) int
        Vertices of each face, padded with -1.
    picked : mapping of int to int
        Marked vertices by landmark (position in the 66); may be empty.

    Returns
    -------
    FittedTemplate
        The best fit.

    Raises
    ------
    HeadError
        If nothing of the mesh is near the skin of the template, in any attitude.
    """
    best: FittedTemplate | None = None
    for attitude in _ATTITUDES[:1] if picked else _ATTITUDES:
        turned = places @ attitude.T
        for part in _heads_of(turned, picked):
            numbers = np.full(len(places) + 1, -1)
            numbers[part] = np.arange(len(part))
            within = (numbers[faces] >= 0) | (faces < 0)
            surface = Surface(turned[part], numbers[faces[within.all(axis=1)]])
            marks = {landmark: int(numbers[vertex]) for landmark, vertex in picked.items()}
            fitted = _fit_in_attitude(template, surface, marks, part, attitude)
            if best is None or fitted.strain < best.strain:
                best = fitted
            if best.strain < _LOW_STRAIN:
                return best
    if best is None or not np.isfinite(best.strain):
        raise HeadError("No face was found on the mesh. Mark the corners of eyes and mouth, nose and chin.")
    return best


def _fit_in_attitude(
    template: Template, surface: Surface, marks: Mapping[int, int], part: NDArray[np.intp], attitude: FloatArray
) -> FittedTemplate:
    pose = _pose_from_marks(template, surface.places, marks) if marks else _pose_from_shape(template, surface)
    bent, residual = _bend(template, surface, pose, marks)
    strain = _strain(template, bent) if np.isfinite(residual) else np.inf
    return FittedTemplate(attitude, part, marks, surface, pose, bent, residual / pose[0], strain)


def _heads_of(places: FloatArray, picked: Mapping[int, int]) -> list[NDArray[np.intp]]:
    """Vertices that may form the head: those around the marks; else all, or tops of a mesh as tall as a body."""
    if picked:
        marks = places[list(picked.values())]
        centre = marks.mean(axis=0)
        reach = _MARKS_REACH * float(np.linalg.norm(marks - centre, axis=1).max())
        return [np.flatnonzero(np.linalg.norm(places - centre, axis=1) < reach)]
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    if extent[1] < _BODY_RATIO * extent.min():
        return [np.arange(len(places))]
    tops = [np.flatnonzero(places[:, 1] < low[1] + share * extent[1]) for share in _HEAD_SHARES]
    return [top for top in tops if len(top) > N_LANDMARKS]


def _strain(template: Template, bent: FloatArray) -> float:
    """Mean distance of the bent landmarks from their best similarity, in outer-eye distances."""
    source, target = template.places[template.landmarks], bent[template.landmarks]
    size, rotation, shift = _similarity(source, target)
    away = np.linalg.norm(size * source @ rotation.T + shift - target, axis=1)
    return float(away.mean()) / size


def _pose_from_marks(template: Template, places: FloatArray, picked: Mapping[int, int]) -> Pose:
    return _similarity(template.places[template.landmarks[list(picked)]], places[list(picked.values())])


def _pose_from_shape(template: Template, surface: Surface) -> Pose:
    """The best of the similarities that `_follow` finds from several starts."""
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
    """Iterated closest points (Besl & McKay 1992) from `pose`, without the worst fifth; mean distance, and pose."""
    for _ in range(_RIGID_STEPS):
        size, rotation, shift = pose
        placed = size * template.places[skin] @ rotation.T + shift
        goal = surface.places[surface.nearest(placed, template.normals[skin] @ rotation.T)]
        distance = np.linalg.norm(goal - placed, axis=1)
        kept = distance <= np.quantile(distance, 0.8)
        pose = _similarity(template.places[skin][kept], goal[kept])
    return float(np.minimum(distance / pose[0], 0.3).mean()), pose


def _similarity(source: FloatArray, target: FloatArray) -> Pose:
    """The least-squares similarity from (N, 3) source to target points (Umeyama 1991)."""
    from_centre, to_centre = source.mean(axis=0), target.mean(axis=0)
    a, b = source - from_centre, target - to_centre
    spread = np.linalg.svd(a, compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise HeadError("The marked points lie on one line. Mark eyes, nose and mouth.")
    rotation = fit_rotation(a, b)
    size = float((b * (a @ rotation.T)).sum() / (a * a).sum())
    if not size > 0.0:
        raise HeadError("The marked points do not form a face. Mark them again; left and right are the head's own.")
    return size, rotation, np.asarray(to_centre - size * rotation @ from_centre)


def _bend(template: Template, surface: Surface, pose: Pose, picked: Mapping[int, int]) -> tuple[FloatArray, float]:
    """Bend the template to the mesh: its vertices, and the median distance; infinite if the mesh is elsewhere."""
    size, rotation, shift = pose
    rest = size * template.places @ rotation.T + shift
    bent = rest
    own = template.landmarks[list(picked)]
    for smoothing in _SMOOTHINGS:
        for _ in range(2):
            # Nonrigid closest points (Amberg et al. 2007): always warp the rest shape, so that errors do not
            # accumulate.
            normals = surface_normals(bent, template.faces)
            goal = surface.places[surface.nearest(bent[template.skin], normals[template.skin])]
            distance = np.linalg.norm(goal - bent[template.skin], axis=1)
            # Points that are far away have no counterpart.
            near = distance < 0.15 * size
            if np.count_nonzero(near) + len(own) < _MIN_POINTS:
                return bent, np.inf
            source = np.concatenate([rest[template.skin][near], rest[own]])
            target = np.concatenate([goal[near], surface.places[list(picked.values())]])
            bent = Warp(source, target, 0.05 * smoothing)(rest)
    return bent, float(np.median(distance))
