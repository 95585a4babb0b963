"""Motion of a character's parts: eyes turn, lower teeth follow the jaw, lashes ride on the skin, all else stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..deform.glue import Glue
from ..deform.lid_rims import lid_rims
from ..heads.eyeballs import part_eyeball
from ..heads.parts import Part, Skin
from ..heads.rig import HeadRig
from ..mesh.nearest import NearestPoints
from ..mesh.pieces import islands
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray

_ON_SKIN = 0.03
"""Distance from the skin, in outer-eye distances, below which a vertex rides on the skin directly beneath it. Others,
such as those at the end of a lash, follow the nearest such vertex of their piece."""
_LASH = 0.03
"""Distance from the rim of a lid, in outer-eye distances, within which the lashes of a piece are rooted. A line of
lashes keeps its width when the lid shuts, while the skin beneath it stretches."""
_LASHES = 0.25
"""Distance from that rim, in outer-eye distances, within which all lashes of a piece lie."""
_SMALL = 0.1
"""Size, in outer-eye distances, up to which a piece is a single hair, which is rooted at one point and stays rigid."""
_MIN_EYE = 8
"""Smallest number of vertices of an eye that turns."""


class PartDriver:
    """Poses all vertices of a head: those of its skin are given, and the others follow.

    Parameters
    ----------
    rig : HeadRig
        The head with all its parts.
    skin : Skin
        The skin of the head.
    deformed : HeadRig
        The rig of the skin alone.
    """

    def __init__(self, rig: HeadRig, skin: Skin, deformed: HeadRig) -> None:
        self.rest = rig.all_vertices
        self._skin_rest = np.ascontiguousarray(deformed.vertices, dtype=np.float32)
        self._skin_rows = np.flatnonzero(skin.number >= 0)
        self._copies = skin.number[self._skin_rows]
        kinds = rig.kinds
        self._eyes = []
        for side, kind in enumerate((Part.EYE_RIGHT, Part.EYE_LEFT)):
            rows = np.flatnonzero(kinds == kind)
            if len(rows) > _MIN_EYE:
                sphere, _ = part_eyeball(self.rest[rows])
                self._eyes.append((side, rows, sphere[:3].astype(np.float32)))
        self._teeth = np.flatnonzero(kinds == Part.TEETH_LOWER)
        self._hinge = np.asarray(rig.jaw_pivot, dtype=np.float32)
        self._riding = np.flatnonzero(kinds == Part.ON_SKIN)
        self._glue = self._glued(rig, deformed) if len(self._riding) else None

    @property
    def riding(self) -> tuple[NDArray[np.intp], Glue | None]:
        """The vertices that ride on the skin, and the glue that moves them."""
        return self._riding, self._glue

    @property
    def copies(self) -> NDArray[np.intp]:
        """Vertex of the skin that each vertex coincides with, (A,); -1 for vertices of other parts."""
        of = np.full(len(self.rest), -1)
        of[self._skin_rows] = self._copies
        return of

    @property
    def turning(self) -> list[tuple[str, NDArray[np.intp], NDArray[np.float32]]]:
        """Name, vertices and centre of each part that turns: `eye_right`, `eye_left` and `jaw`."""
        eyes = [(("eye_right", "eye_left")[side], rows, centre) for side, rows, centre in self._eyes]
        return [*eyes, ("jaw", self._teeth, self._hinge)]

    def pose(
        self, skin: NDArray[np.float32], jaw: FloatArray, gaze: FloatArray, *, planar: bool = False
    ) -> NDArray[np.float32]:
        """Pose all vertices.

        Parameters
        ----------
        skin : (U, 3) float32
            Positions of the vertices of the skin.
        jaw : (3, 3) float64
            Rotation of the lower teeth about the hinge of the jaw.
        gaze : (2, 3, 3) float64
            Rotations of the right and left eye about their centres.
        planar : bool
            Whether vertices that ride on the skin keep their depth.

        Returns
        -------
        (A, 3) float32
            Positions as in `HeadRig.all_vertices`.
        """
        out = self.rest.copy()
        out[self._skin_rows] = skin[self._copies]
        for side, rows, centre in self._eyes:
            out[rows] = _turned(self.rest[rows], centre, gaze[side])
        out[self._teeth] = _turned(self.rest[self._teeth], self._hinge, jaw)
        if self._glue is not None:
            out[self._riding] = self._glue.move(skin - self._skin_rest)
        if planar:
            out[self._riding, 2] = self.rest[self._riding, 2]
        return out

    def _glued(self, rig: HeadRig, deformed: HeadRig) -> Glue:
        points = self.rest[self._riding]
        sides = np.asarray(deformed.region_weights).argmax(axis=0)
        rims = _rims(deformed)
        roots, at_rim = self._roots(rig, points, self._skin_rest[rims])
        return Glue(points, roots, deformed.vertices, sides, rig.eye_distance, rims, at_rim)

    def _roots(
        self, rig: HeadRig, points: FloatArray, rims: NDArray[np.float32]
    ) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Vertex among `points` at which each is rooted, (N,): itself on the skin, else the nearest of its piece.

        A piece that reaches the rim of a lid, at `rims` (M, 3), is rooted there alone; the second result tells which.
        """
        unit = rig.eye_distance
        away, to_rim = _distances(self._skin_rest, points), _distances(rims, points)
        roots, at_rim = np.arange(len(points)), np.zeros(len(points), dtype=np.bool_)
        faces = _faces_within(rig, self._riding)
        piece = islands(len(points), faces)
        graph = SurfaceGraph(points, faces)
        for number in range(int(piece.max(initial=-1)) + 1):
            within = np.flatnonzero(piece == number)
            reach = to_rim[within]
            small = np.ptp(points[within], axis=0).max() <= _SMALL * unit
            if reach.min() <= _LASH * unit and reach.max() <= _LASHES * unit:
                near = within[[int(reach.argmin())]] if small else within[reach <= _LASH * unit]
                at_rim[within] = True
            elif small:
                near = within[[int(away[within].argmin())]]
            elif away[within].max() > _ON_SKIN * unit:
                near = within[away[within] <= max(_ON_SKIN * unit, 1.5 * float(away[within].min()))]
            else:
                continue
            roots[within] = _nearest_along(graph, within, near)
        return roots, at_rim


def _rims(skin: HeadRig) -> NDArray[np.intp]:
    """Vertices of the rims of all lids, (M,)."""
    if skin.faces is None:
        return np.empty(0, dtype=np.intp)
    eyes = lid_rims(skin.vertices, skin.faces, skin.landmarks, skin.region_weights)
    rims = [lid for eye in eyes for lid in (eye.upper, eye.lower)]
    return np.unique(np.concatenate(rims)) if rims else np.empty(0, dtype=np.intp)


def _distances(places: FloatArray, points: FloatArray) -> FloatArray:
    """Distance of each of `points` (N, 3) from the nearest of `places`, (N,); infinite without places."""
    if not len(places):
        return np.full(len(points), np.inf)
    _, squared = NearestPoints(places).query(points)
    return np.asarray(np.sqrt(np.maximum(squared[:, 0], 0.0)))


def _nearest_along(graph: SurfaceGraph, piece: IntArray, seeds: IntArray) -> NDArray[np.intp]:
    """Find for each vertex of a piece the seed that is nearest along its edges."""
    reached = graph.nearest_seeds(seeds)
    return np.where(reached[piece] >= 0, reached[piece], seeds[0])


def _faces_within(rig: HeadRig, rows: IntArray) -> NDArray[np.intp]:
    """Faces between the vertices `rows`, (F, K), as indices into these."""
    faces = rig.all_faces
    number = np.full(len(rig.kinds) + 1, -1)
    number[rows] = np.arange(len(rows))
    within = ((number[faces] >= 0) | (faces < 0)).all(axis=1)
    return np.asarray(number[faces[within]], dtype=np.intp)


def _turned(points: NDArray[np.float32], centre: NDArray[np.float32], rotation: FloatArray) -> NDArray[np.float32]:
    return centre + (points - centre) @ rotation.T.astype(np.float32)
