"""Fitting of the template to a mesh, guided by marks or by a face that is seen (method.md, section 7.1)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from ..errors import HeadError, Message
from ..face.landmarks import BROWS, INNER, LIPS, N_LANDMARKS, NOSE
from ..mesh.kernels import Warp
from ..mesh.surface import surface_normals
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .landmark_vertices import ORGANS
from .portrait import Paint
from .sight import Sight, look
from .template import Pose, Surface, Template, follow, pose_from_shape, rough_poses, similarity
from .views import View, seen_view, views_of

NOT_FOUND = Message("No face was found on the mesh. Mark the corners of eyes and mouth, nose and chin.")
_LOW_STRAIN = 0.045
"""Strain in outer-eye distances below which an attitude is accepted. Human heads have 0.02 to 0.035, wrong attitudes
0.05 and more."""
_UNUSUAL_STRAIN = 0.07
"""Strain above which a head is stylised, so that even clearly seen landmarks may be off."""
_SMOOTHINGS = (1.0, 0.3, 0.1)
"""Smoothness of successive warps, as a multiple of the smoothing in `_bend`."""
_LIKELY = 4
"""Number of attitudes besides the upright one in which the template is bent to a mesh on which no face is seen."""
_MIN_POINTS = 5
"""Smallest number of points of a warp; four determine its affine part."""
_SOFTNESS = np.full(N_LANDMARKS, 0.3)
_SOFTNESS[NOSE] = 2.0
"""Allowed distance of landmarks from where they are seen, relative to that of the skin from the mesh. The nose is
allowed more, as its shape shows where its landmarks are."""
_EXACT = 0.002
"""Mean distance in outer-eye distances below which a mesh is the built-in head itself, whose landmarks are exact."""
_AGREEMENT = 0.12
"""Median distance, in outer-eye distances, between seen landmarks and marks above which the seen face is rejected."""
_SPREAD = 0.15
"""Ratio of the extents of the marks below which they nearly lie on one line, so that small errors rotate the head about
it. On the template the corners of the eyes have 0.08, any other four points 0.2 and more."""
_TURNS = np.radians((0.0, -45.0, 45.0, -90.0, 90.0, -135.0, 135.0, 180.0))
"""Rotations about that line in which a face is sought."""
_BIAS = np.zeros(N_LANDMARKS)
"""Share of the tracker's error on the template that is expected on any mesh."""
_BIAS[BROWS] = 0.5
_BIAS[LIPS] = 0.15


@dataclass(frozen=True)
class Guides:
    """Places that points of the template are drawn to.

    Attributes
    ----------
    source : (N, 3) float64
        Places on the template at rest, in outer-eye distances.
    target : (N, 3) float64
        Places on the mesh.
    softness : (N,) float64
        Softness, as a multiple of that of the skin.
    """

    source: FloatArray
    target: FloatArray
    softness: FloatArray

    def joined(self, other: Guides) -> Guides:
        """Return these guides and the others."""
        both = (np.concatenate(pair) for pair in zip(vars(self).values(), vars(other).values(), strict=True))
        return Guides(*both)


@dataclass(frozen=True)
class FittedTemplate:
    """The template after it was fitted to a mesh.

    Attributes
    ----------
    view : View
        The head within the mesh, and its attitude.
    sight : Sight or None
        The face that was seen in this view.
    marks : mapping
        Marked vertex of the view, by landmark.
    bent : (T, 3) float64
        Vertices of the bent template.
    residual : float
        Median distance to the mesh, in outer-eye distances.
    strain : float
        Mean distance of the bent landmarks from their best similarity, in outer-eye distances.
    """

    view: View
    sight: Sight | None
    marks: Mapping[int, int]
    pose: Pose
    bent: FloatArray
    residual: float
    strain: float

    @property
    def sure(self) -> bool:
        """Whether this is a face in this attitude, by its shape alone, or because it is seen and not bent too far."""
        seen = self.sight is not None and self.sight.sure
        return self.strain < (_UNUSUAL_STRAIN if seen else _LOW_STRAIN)


def fit_template(
    template: Template,
    places: FloatArray,
    faces: IntArray,
    picked: Mapping[int, int],
    paint: Paint | None = None,
) -> FittedTemplate:
    """Fit the template to a mesh of vertices (V, 3) or to its head, with the marked vertices by landmark, if any.

    Without marks, the attitude is the one in which a face is seen or, if none is clearly seen, the one that bends the
    template least. Raises HeadError if no part of the mesh is near the skin of the template in any attitude, or nothing
    looks like a face.
    """
    seen: FittedTemplate | None = None
    if not picked and (found := seen_view(places, faces, paint)) is not None:
        seen = _fit(template, *found, {})
        if found[1].sure and np.isfinite(seen.strain):
            return seen
    best = _fit_by_shape(template, views_of(places, faces, picked, paint), len(places), picked)
    if seen is not None and not (best is not None and best.strain < _LOW_STRAIN):
        best = seen
    if best is None or not np.isfinite(best.strain) or not (picked or best.sight or best.strain < _LOW_STRAIN):
        raise HeadError(NOT_FOUND)
    return best


def _fit_by_shape(
    template: Template, views: Iterator[View], count: int, picked: Mapping[int, int]
) -> FittedTemplate | None:
    """Return the first fit that hardly bends the template, or else the one that bends it least."""
    best: FittedTemplate | None = None
    for view in _likely_first(template, views):
        numbers = np.full(count, -1)
        numbers[view.part] = np.arange(len(view.part))
        fitted = _fit(template, view, None, {landmark: int(numbers[v]) for landmark, v in picked.items()})
        if best is None or fitted.strain < best.strain:
            best = fitted
        if best.strain < _LOW_STRAIN:
            break
    return best


def _likely_first(template: Template, views: Iterator[View]) -> Iterator[View]:
    """Yield the first view, and then those few of the others to which the template comes nearest."""
    yield from islice(views, 1)
    rough = [(_rough_distance(template, view), view) for view in views]
    for _, view in sorted(rough, key=lambda pair: pair[0])[:_LIKELY]:
        yield view


def _rough_distance(template: Template, view: View) -> float:
    """Distance of the template from a mesh after a rough alignment; infinite if it collapses onto a few vertices."""
    try:
        return rough_poses(template, Surface(view.places, view.faces))[0][0]
    except HeadError:
        return np.inf


def _fit(template: Template, view: View, sight: Sight | None, marks: Mapping[int, int]) -> FittedTemplate:
    surface = view.surface
    guides = _of_marks(template, surface, marks)
    try:
        if marks:
            pose, sight = _posed(template, view, guides, marks)
        if sight is not None:
            guides = guides.joined(_of_sight(template, sight, marks))
        elif marks:
            guides = guides.joined(_of_organs(template, guides, pose, marks))
        if sight is not None:
            pose = similarity(guides.source, guides.target)
        elif not marks:
            pose = pose_from_shape(template, surface)
        if sight and not marks:
            distance, closest = follow(template, surface, pose, template.skin)
            pose, guides = (closest, _of_marks(template, surface, {})) if distance < _EXACT else (pose, guides)
    except HeadError:
        if marks:
            raise
        return FittedTemplate(view, sight, marks, (1.0, np.eye(3), np.zeros(3)), template.places, np.inf, np.inf)
    bent, residual = _bend(template, surface, pose, guides)
    strain = _strain(template, bent) if np.isfinite(residual) else np.inf
    return FittedTemplate(view, sight, marks, pose, bent, residual / pose[0], strain)


def _posed(template: Template, view: View, marked: Guides, marks: Mapping[int, int]) -> tuple[Pose, Sight | None]:
    """Return the pose that the marks determine, and the face that is seen in it.

    If the marks nearly lie on one line, the face is sought in several rotations about it. If none is seen, the one in
    which the template is nearest to the mesh is returned.
    """
    poses = _poses(marked)
    for pose in poses:
        if (sight := _seen_along(view, pose, marks)) is not None:
            return pose, sight
    if len(poses) == 1:
        return poses[0], None
    return min(poses, key=lambda pose: follow(template, view.surface, pose, template.skin[::2], 1)[0]), None


def _poses(marked: Guides) -> list[Pose]:
    """Return the pose of marked points, or several if they nearly lie on one line, the most upright one first."""
    size, rotation, shift = similarity(marked.source, marked.target)
    middle = marked.source.mean(axis=0)
    _, extents, axes = linalg.svd(marked.source - middle)
    if extents[1] > _SPREAD * extents[0]:
        return [(size, rotation, shift)]
    x, y, z = axes[0]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues: tr(R T(a)) is largest where its derivative, tr(R K) cos a + tr(R K K) sin a, is 0.
    upright = np.arctan2(np.trace(rotation @ cross), -np.trace(rotation @ cross @ cross))
    goal, poses = marked.target.mean(axis=0), []
    for angle in upright + _TURNS:
        turn = rotation @ (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
        poses.append((size, turn, np.asarray(goal - size * turn @ middle)))
    return poses


def _seen_along(view: View, pose: Pose, marks: Mapping[int, int]) -> Sight | None:
    """Return the face that is seen from the direction that the marks imply, if it agrees with them."""
    size, rotation, _ = pose
    sight = look(view.places @ rotation, view.faces, view.paint)
    if sight is None or not sight.sure:
        return None
    sight = replace(sight, points=sight.points @ rotation.T)
    off = np.linalg.norm(sight.points[list(marks)] - view.places[list(marks.values())], axis=1)
    return sight if float(np.median(off)) < _AGREEMENT * size else None


def _of_marks(template: Template, surface: Surface, marks: Mapping[int, int]) -> Guides:
    source = template.places[template.landmarks[list(marks)]]
    return Guides(source, surface.places[list(marks.values())], np.ones(len(source)))


def _of_organs(template: Template, marked: Guides, pose: Pose, marks: Mapping[int, int]) -> Guides:
    """Guide eyes and mouth to between their marked corners, in the proportions of the template."""
    own, order = template.places[template.landmarks], list(marks)
    guides = Guides(*(values[:0] for values in vars(marked).values()))
    for organ, corners in ORGANS:
        if not set(corners) <= marks.keys():
            continue
        ends = marked.target[[order.index(corner) for corner in corners]]
        size = np.linalg.norm(ends[1] - ends[0]) / np.linalg.norm(own[corners[1]] - own[corners[0]])
        led = np.setdiff1d(organ, order)
        target = size * (own[led] - own[list(corners)].mean(axis=0)) @ pose[1].T + ends.mean(axis=0)
        guides = guides.joined(Guides(own[led], target, _SOFTNESS[led]))
    return guides


def _of_sight(template: Template, sight: Sight, marks: Mapping[int, int]) -> Guides:
    """Guide the unmarked inner landmarks of the template to where they are seen.

    The tracker is off in the same way on any mesh without texture, for instance at brows. The sources are therefore
    moved by a share towards the places where it sees the landmarks of the template.
    """
    led = np.setdiff1d(INNER, list(marks))
    source = own = template.places[template.landmarks]
    if not sight.painted:
        source = own + _BIAS[:, None] * (template.seen - own)
    return Guides(source[led], sight.points[led], _SOFTNESS[led] / sight.certainty[led])


def _strain(template: Template, bent: FloatArray) -> float:
    """Mean distance of the bent landmarks from their best similarity, in outer-eye distances."""
    source, target = template.places[template.landmarks], bent[template.landmarks]
    size, rotation, shift = similarity(source, target)
    away = np.linalg.norm(size * source @ rotation.T + shift - target, axis=1)
    return float(away.mean()) / size


def _bend(template: Template, surface: Surface, pose: Pose, guides: Guides) -> tuple[FloatArray, float]:
    """Bend the template to the mesh; return its vertices and the median distance, infinite if the mesh is elsewhere."""
    size, rotation, shift = pose
    rest = size * template.places @ rotation.T + shift
    led = size * guides.source @ rotation.T + shift
    bent = rest
    # Nonrigid closest points (Amberg et al. 2007): warps of decreasing smoothness, two iterations each.
    for smoothing in _SMOOTHINGS:
        for _ in range(2):
            # The rest shape is always the one that is warped, so that errors do not accumulate.
            normals = surface_normals(bent, template.faces)
            goal = surface.places[surface.nearest(bent[template.skin], normals[template.skin])]
            distance = np.linalg.norm(goal - bent[template.skin], axis=1)
            # Points that are far away have no counterpart.
            near = distance < 0.15 * size
            if np.count_nonzero(near) + len(led) < _MIN_POINTS:
                return bent, np.inf
            source = np.concatenate([rest[template.skin][near], led])
            target = np.concatenate([goal[near], guides.target])
            softness = np.concatenate([np.ones(np.count_nonzero(near)), guides.softness])
            bent = Warp(source, target, 0.05 * smoothing * softness)(rest)
    return bent, float(np.median(distance))
