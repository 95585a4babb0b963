"""The attitudes in which a mesh may be a head, and the one in which a face is seen (method.md, section 7.1)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import INNER, N_LANDMARKS
from ..face.rotation import euler_to_matrix
from ..numeric.arrays import FloatArray, IntArray
from .portrait import Paint
from .sight import Sight, look
from .template import Surface

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
"""Attitudes of a mesh: facing the viewer, facing away, on its back or face, to a side, upside down, on an ear."""
_BODY_RATIO = 2.6
"""Ratio of height to smallest extent above which a mesh is more than a head."""
_HEAD_SHARES = (1.0 / 6.0, 1.0 / 4.0, 0.4)
"""Share of a body's height that head and neck may take: of an adult, a child, a cartoon character."""
_MARKS_REACH = 3.0
"""Reach of the head around the centre of the marks, as a multiple of the distance of the outermost mark."""


@dataclass(frozen=True)
class View:
    """A mesh in one attitude, or the part of it that may be the head.

    Attributes
    ----------
    attitude : (3, 3) float64
        Rotation that was applied to the mesh.
    part : (P,) intp
        Vertices of the mesh that belong to the view.
    places : (P, 3) float64
        Their rotated positions.
    faces : (F, K) int
        Faces between them, padded with -1.
    paint : Paint or None
        Their colours.
    """

    attitude: FloatArray
    part: NDArray[np.intp]
    places: FloatArray
    faces: IntArray
    paint: Paint | None = None

    @cached_property
    def surface(self) -> Surface:
        """The surface that the template follows."""
        return Surface(self.places, self.faces)


def views_of(
    places: FloatArray, faces: IntArray, picked: Mapping[int, int], paint: Paint | None = None
) -> Iterator[View]:
    """Yield the views in which the mesh may be a head, the upright one that faces the viewer first.

    With marked vertices, by landmark, there is only one.
    """
    for attitude in _ATTITUDES[:1] if picked else _ATTITUDES:
        turned = places @ attitude.T
        parts = [_around(turned, turned[list(picked.values())])] if picked else _heads_of(turned)
        for part in parts:
            yield _view(attitude, turned, faces, part, paint)


def seen_view(places: FloatArray, faces: IntArray, paint: Paint | None = None) -> tuple[View, Sight] | None:
    """Find the view in which the face is seen most clearly, of the head alone if the mesh has a body.

    It is None if no face is seen in any.
    """
    best: tuple[View, Sight] | None = None
    for view in views_of(places, faces, {}, paint):
        sight = look(view.places, view.faces, view.paint)
        if sight is not None and (best is None or sight.clarity > best[1].clarity):
            best = view, sight
        # Most meshes are upright and face the viewer; the other attitudes are tried while none shows a face beyond
        # doubt.
        if sight is not None and sight.sure:
            break
    if best is None or len(best[0].part) == len(places):
        return best
    view, sight = best
    turned = places @ view.attitude.T
    return _view(view.attitude, turned, faces, _around(turned, sight.points[INNER]), paint), sight


def _view(
    attitude: FloatArray, turned: FloatArray, faces: IntArray, part: NDArray[np.intp], paint: Paint | None
) -> View:
    if len(part) == len(turned):
        return View(attitude, part, turned, faces, paint)
    numbers = np.full(len(turned) + 1, -1)
    numbers[part] = np.arange(len(part))
    within = ((numbers[faces] >= 0) | (faces < 0)).all(axis=1)
    kept = None if paint is None else paint.of_faces(within)
    return View(attitude, part, turned[part], numbers[faces[within]], kept)


def _around(places: FloatArray, points: FloatArray) -> NDArray[np.intp]:
    """Vertices of the head to which some points of a face belong."""
    centre = points.mean(axis=0)
    reach = _MARKS_REACH * float(np.linalg.norm(points - centre, axis=1).max())
    return np.flatnonzero(np.linalg.norm(places - centre, axis=1) < reach)


def _heads_of(places: FloatArray) -> list[NDArray[np.intp]]:
    """Sets of vertices that may form the head: the tops of a mesh as tall as a body, and all."""
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    if extent[1] < _BODY_RATIO * extent.min():
        return [np.arange(len(places))]
    tops = [_top(places, low[1], share * extent[1]) for share in _HEAD_SHARES]
    return [*(top for top in tops if len(top) > N_LANDMARKS), np.arange(len(places))]


def _top(places: FloatArray, highest: float, height: float) -> NDArray[np.intp]:
    """Vertices within a `height` of the `highest`, without arms that are stretched out beside the head."""
    below = places[:, 1] - highest
    middle = np.median(places[below < height / 2.0, 0])
    return np.flatnonzero((below < height) & (np.abs(places[:, 0] - middle) < height))
