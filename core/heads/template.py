"""The built-in head as a template, the surface that it is fitted to, and similarities that align the two (method.md,
section 7.1).
"""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import EYE_LEFT, EYE_RIGHT, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, MOUTH_OUTER, outer_eye_distance
from ..face.rotation import fit_rotation
from ..mesh.kernels import distances
from ..mesh.surface import NearestPoints, surface_normals
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .built_in import load_head
from .sight import look

_SCALES = (0.8, 1.0, 1.25)
"""Starts of the alignment without marks: sizes relative to the mesh's half width."""
_HEIGHTS = (-0.35, -0.15, 0.05, 0.25)
"""Starts: heights of the eyes relative to the middle of the mesh, in heights of the mesh."""
_RIGID_STEPS = 25
_COARSE = 16
"""All starts are followed with one in this many vertices of the template."""
_COARSE_STEPS = 8
"""Number of steps for which they are."""
_PURSUED = 3
"""Number of the best starts that are continued: a third of the time that it takes to continue all, for the same
landmarks on the heads of the tests."""


_EXCLUDED = (
    (np.concatenate([EYE_RIGHT, EYE_LEFT]), 0.12),
    (np.concatenate([MOUTH_OUTER, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER]), 0.06),
)
"""Landmarks, and the distance from them in outer-eye distances within which the template does not follow the mesh. On a
scan, whose eyes and mouth are closed by skin, nearest places there are often wrong; the surrounding skin carries
them."""
_AROUND = 0.3
"""Distance, in outer-eye distances, that counts as around a lid or lip."""
_CLOSE_BY = 12
"""Number of nearest vertices among which that of a landmark is chosen."""
_SAMPLES = 900
"""Number of points of the template that follow the mesh."""


class Template:
    """The skin of the built-in head in outer-eye distances, and the sample of its points that follow the mesh."""

    def __init__(self) -> None:
        head = load_head()
        points = head.vertices[head.landmarks].astype(np.float64)
        unit = outer_eye_distance(points)
        self.places = (head.vertices - points.mean(axis=0)) / unit
        self.faces: IntArray = head.faces
        self.landmarks: IntArray = head.landmarks
        self.normals = surface_normals(self.places, head.faces)
        # Points of moving skin that do not face away from the viewer (-z), at some distance from lids and lips.
        outside = (head.regions.sum(axis=0) > 0.5) & (self.normals[:, 2] < 0.2)
        for part, apart in _EXCLUDED:
            marks = self.places[self.landmarks[part]]
            outside &= distances(self.places, marks).min(axis=1) > apart
        self.skin = np.flatnonzero(outside)[:: max(1, int(outside.sum()) // _SAMPLES)]

    @cached_property
    def seen(self) -> FloatArray:
        """Places of the template where the tracker sees the landmarks, (66, 3)."""
        sight = look(self.places, self.faces)
        assert sight is not None
        return sight.points

    def landmark_normals(self, bent: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (66, 3) normals of the landmarks on the bent vertices, and the same averaged around lids and lips.

        Where a warp has folded the template over, its normals are those of the template in its pose, of which
        `rotation` is a part.
        """
        normals, posed = surface_normals(bent, self.faces), self.normals @ rotation.T
        folded = np.einsum("vd,vd->v", normals, posed) < 0.0
        normals[folded] = posed[folded]
        own = normals[self.landmarks]
        around = own.copy()
        for part, _ in _EXCLUDED:
            away = np.linalg.norm(self.places[self.landmarks[part], None] - self.places[self.skin], axis=2)
            total = (away < _AROUND).astype(np.float64) @ normals[self.skin]
            around[part] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
        return own, around


class Surface:
    """A mesh to which the template is fitted, which finds the nearest vertices that face the same way."""

    def __init__(self, places: FloatArray, faces: IntArray) -> None:
        self.places, self.faces, self.normals = places, faces, surface_normals(places, faces)
        # Opposite normals are as far apart as 0.3 of the smallest extent.
        self._weight = 0.15 * float(np.ptp(places, axis=0).min())
        self._points = NearestPoints(self._key(places, self.normals))

    def nearest(self, places: FloatArray, normals: FloatArray) -> NDArray[np.intp]:
        """Find the nearest vertices (N,) that face the same way as places (N, 3) with unit normals (N, 3)."""
        found, _ = self._points.query(self._key(places, normals))
        return found[:, 0]

    def close_by(self, places: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the (N, K) vertices nearest to (N, 3) positions, whichever way they face, and their distances."""
        count = min(_CLOSE_BY, len(self.places))
        found, squared = NearestPoints(self.places).query(places, count)
        return found, np.sqrt(squared)

    def _key(self, places: FloatArray, normals: FloatArray) -> FloatArray:
        return np.concatenate([places, self._weight * normals], axis=1)


@cache
def load_template() -> Template:
    """Return the template, which is prepared once."""
    return Template()


Pose = tuple[float, FloatArray, FloatArray]
"""Scale, rotation and translation of the template: ``s R x + t``."""


def rough_poses(template: Template, surface: Surface) -> list[tuple[float, Pose]]:
    """Align the template with a mesh from several starts, roughly and without marks.

    The distances and similarities are as from `follow`, the smallest distance first.
    """
    low, high = surface.places.min(axis=0), surface.places.max(axis=0)
    coarse = template.skin[::_COARSE]
    found: list[tuple[float, Pose]] = []
    for scale in _SCALES:
        size = scale * float(high[0] - low[0]) / 2.0
        # The face, which is nearest to the viewer (smallest z), starts at the depth of the mesh's front; a percentile
        # instead of the minimum, so that a few vertices that stick out do not count.
        depth = float(np.percentile(surface.places[:, 2], 0.5)) - size * float(
            template.places[template.skin[::2], 2].min()
        )
        for height in _HEIGHTS:
            middle = (low + high) / 2.0
            start = np.array([middle[0], middle[1] + height * (high[1] - low[1]), depth])
            found.append(follow(template, surface, (size, np.eye(3), start), coarse, _COARSE_STEPS))
    return sorted(found, key=lambda pair: pair[0])


def pose_from_shape(template: Template, surface: Surface) -> Pose:
    """Return the similarity that aligns the template best with a mesh, without marks."""
    found = rough_poses(template, surface)[:_PURSUED]
    skin = template.skin[::2]
    return min((follow(template, surface, pose, skin) for _, pose in found), key=lambda pair: pair[0])[1]


def follow(
    template: Template, surface: Surface, pose: Pose, skin: NDArray[np.intp], steps: int = _RIGID_STEPS
) -> tuple[float, Pose]:
    """Align the template with a mesh by iterated closest points (Besl & McKay 1992), without the worst fifth of pairs.

    `skin` are the vertices of the template to use. There are at most `steps` steps from `pose`, fewer if the pairs stay
    the same. Returns the mean distance to the mesh in outer-eye distances, each counted as at most 0.3, and the last
    similarity.
    """
    before: NDArray[np.intp] | None = None
    for _ in range(steps):
        size, rotation, shift = pose
        placed = size * template.places[skin] @ rotation.T + shift
        pairs = surface.nearest(placed, template.normals[skin] @ rotation.T)
        goal = surface.places[pairs]
        # Trimming: ears, hair and the neck of the template have no counterpart on many meshes, and would pull the face.
        distance = np.linalg.norm(goal - placed, axis=1)
        kept = distance <= np.quantile(distance, 0.8)
        if before is not None and np.array_equal(pairs, before):
            break
        before, pose = pairs, similarity(template.places[skin][kept], goal[kept])
    return float(np.minimum(distance / pose[0], 0.3).mean()), pose


def similarity(source: FloatArray, target: FloatArray) -> Pose:
    """Fit the least-squares similarity from points (N, 3) to corresponding ones (Umeyama 1991).

    Raises HeadError if the points lie on one line, or form no face.
    """
    from_centre, to_centre = source.mean(axis=0), target.mean(axis=0)
    a, b = source - from_centre, target - to_centre
    # Points on a line leave the rotation about it open: their second singular value is 0.
    spread = linalg.svdvals(a)
    if spread[1] < 1e-6 * spread[0]:
        raise HeadError("The marked points lie on one line. Mark eyes, nose and mouth.")
    rotation = fit_rotation(a, b)
    # s = <b, R a> / |a|^2 minimises |s R a - b|^2 for the best R.
    size = float((b * (a @ rotation.T)).sum() / (a * a).sum())
    if not size > 0.0:
        raise HeadError("The marked points do not form a face. Mark them again; left and right are the head's own.")
    return size, rotation, np.asarray(to_centre - size * rotation @ from_centre)
