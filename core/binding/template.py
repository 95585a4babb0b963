"""The built-in head as a template, and the surface that it is fitted to (method.md, section 7.1)."""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import EYE_LEFT, EYE_RIGHT, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, MOUTH_OUTER, outer_eye_distance
from ..heads.built_in import load_head
from ..mesh.nearest import NearestPoints
from ..mesh.surface import surface_normals
from ..numeric.arrays import FloatArray, IntArray
from .sight import look

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
            outside &= np.linalg.norm(self.places[:, None] - marks, axis=2).min(axis=1) > apart
        self.skin = np.flatnonzero(outside)[:: max(1, int(outside.sum()) // _SAMPLES)]

    @cached_property
    def seen(self) -> FloatArray:
        """Places of the template where the tracker sees the landmarks, (66, 3)."""
        sight = look(self.places, self.faces)
        assert sight is not None
        return sight.points

    def landmark_normals(self, bent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (66, 3) normals of the landmarks on the bent vertices, and the same averaged around lids and lips."""
        normals = surface_normals(bent, self.faces)
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
        """Find the nearest vertices that face the same way.

        Parameters
        ----------
        places : (N, 3) float64
            Positions in the frame and unit of the mesh.
        normals : (N, 3) float64
            Unit normals.

        Returns
        -------
        (N,) int
            The nearest vertices.
        """
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
