"""Motion of a character's parts: eyes turn, lower teeth follow the jaw, lashes ride on the skin, all else stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..deform.lid_rims import lid_rims
from ..heads.eyeballs import part_eyeball
from ..heads.rig import HeadRig, Part, Skin
from ..heads.tongues import tongue_of, tongue_out
from ..mesh.surface import NearestPoints, SurfaceGraph, islands, surface_normals
from ..numeric.arrays import FloatArray, IntArray
from .glue import Glue, Roots
from .gums import Gums

_ON_SKIN = 0.03
"""Distance from the skin, in outer-eye distances, below which a vertex rides on the skin directly beneath it. Others,
such as those at the end of a lash, follow the nearest such vertex of their piece."""
_JOINED = 1e-3
"""Distance from the skin, in outer-eye distances, below which a piece is joined to it."""
_LASH = 0.03
"""Distance from the rim of a lid, in outer-eye distances, within which lashes are rooted in any case. A line of lashes
keeps its width when the lid shuts, while the skin beneath it stretches."""
_OFF_RIM = 0.08
"""Largest distance of the roots of lashes from that rim. MakeHuman's lie in rows that begin 0.002 to 0.064 away."""
_ROW = 0.02
"""Distance beyond its nearest vertex within which a row of lashes has its roots."""
_STEPS = 4
"""Parts into which each edge of a rim is divided to find what reaches it."""
_LASHES = 0.25
"""Distance from that rim, in outer-eye distances, within which all lashes of a piece lie."""
_SMALL = 0.1
"""Size, in outer-eye distances, up to which a piece is a single hair, which is rooted at one point and stays rigid."""
_MIN_EYE = 8
"""Smallest number of vertices of an eye that turns."""


class PartDriver:
    """Poses all vertices of a head: the others follow those of its skin, whose rig alone is `deformed`.

    `kept` (U,) is the vertex of the head of each vertex of the skin, and `others` (O,) are those of other parts. `gums`
    are the lower teeth and gums that the skin covers.
    """

    def __init__(self, rig: HeadRig, skin: Skin, deformed: HeadRig) -> None:
        self.rest = rig.all_vertices
        self._skin_rest = np.ascontiguousarray(deformed.vertices, dtype=np.float32)
        self._skin_rows = np.flatnonzero(skin.number >= 0)
        self._copies = skin.number[self._skin_rows]
        self.kept, self.others = skin.kept, np.setdiff1d(np.arange(len(self.rest)), self._skin_rows)
        kinds = rig.kinds
        self._eyes = []
        for side, kind in enumerate((Part.EYE_RIGHT, Part.EYE_LEFT)):
            rows = np.flatnonzero(kinds == kind)
            if len(rows) > _MIN_EYE:
                sphere, _ = part_eyeball(self.rest[rows])
                self._eyes.append((side, rows, sphere[:3].astype(np.float32)))
        self._teeth = np.flatnonzero(kinds == Part.TEETH_LOWER)
        self._tongue, self._out = tongue_of(rig), np.zeros((len(self._teeth), 3), dtype=np.float32)
        if self._tongue.any():
            self._out[self._tongue[self._teeth]] = tongue_out(rig, self._tongue)
        self.gums = Gums(rig, deformed, self._tongue)
        self._hinge = np.asarray(rig.jaw_pivot, dtype=np.float32)
        self._riding = np.flatnonzero(kinds == Part.ON_SKIN)
        self._glue = self._glued(rig, deformed) if len(self._riding) else None
        self._at, self._from, self._riders = (_span(rows) for rows in (self._skin_rows, self._copies, self._riding))

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

    @property
    def tongue(self) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
        """Vertices of the tongue, (T,), and their displacements (T, 3) when it is out."""
        return np.flatnonzero(self._tongue), self._out[self._tongue[self._teeth]]

    def pose(
        self,
        skin: NDArray[np.float32],
        jaw: FloatArray,
        gaze: FloatArray,
        tongue: float = 0.0,
        *,
        planar: bool = False,
    ) -> NDArray[np.float32]:
        """Return the positions (A, 3) of all vertices, as in `HeadRig.all_vertices`, for those (U, 3) of the skin.

        `jaw` (3, 3) rotates the lower teeth about the hinge of the jaw, and `gaze` (2, 3, 3) the right and left eye
        about their centres; `tongue` is the share by which the tongue is out. If `planar`, vertices that ride on the
        skin keep their depth.
        """
        out = self.rest.copy()
        out[self._at] = skin[self._from]
        for side, rows, centre in self._eyes:
            out[rows] = _turned(self.rest[rows], centre, gaze[side])
        teeth = self.rest[self._teeth]
        if tongue:
            teeth += np.float32(tongue) * self._out
        out[self._teeth] = _turned(teeth, self._hinge, jaw)
        self.gums.hold(out, skin)
        if self._glue is not None:
            out[self._riders] = self._glue.move(skin - self._skin_rest)
        if planar:
            out[self._riders, 2] = self.rest[self._riders, 2]
        return out

    def _glued(self, rig: HeadRig, deformed: HeadRig) -> Glue:
        points = self.rest[self._riding]
        sides = np.asarray(deformed.region_weights).argmax(axis=0)
        rims, along = _rims(deformed)
        roots = self._roots(rig, points, along, self._behind(points, deformed), sides)
        return Glue(points, roots, deformed.vertices, sides, rig.eye_distance, rims, deformed.faces)

    def _behind(self, points: FloatArray, deformed: HeadRig) -> NDArray[np.bool_]:
        """Whether each of `points` (N, 3) lies behind the skin nearest to it, and not on it, (N,)."""
        if deformed.faces is None:
            return np.zeros(len(points), dtype=np.bool_)
        (nearest, squared), unit = NearestPoints(self._skin_rest).query(points), deformed.eye_distance
        normals = surface_normals(self._skin_rest, deformed.faces)[nearest[:, 0]]
        depth = ((self._skin_rest[nearest[:, 0]] - points) * normals).sum(axis=1)
        return np.asarray((squared[:, 0] > (_ON_SKIN * unit) ** 2) & (depth > 0.0))

    def _roots(
        self, rig: HeadRig, points: FloatArray, rims: FloatArray, behind: NDArray[np.bool_], sides: IntArray
    ) -> Roots:
        """Find what holds `points` (N, 3): each is rooted itself on or `behind` (N,) the skin, or at the nearest such
        vertex of its piece.

        A piece that reaches the rim of a lid, all along which are `rims` (M, 3), is rooted there alone. What is behind
        the skin is a wall, and on the one of the `sides` (U,) of the skin to which it is joined, along its edges.
        """
        unit = rig.eye_distance
        nearest, squared = NearestPoints(self._skin_rest).query(points)
        away, to_rim = np.sqrt(np.maximum(squared[:, 0], 0.0)), _distances(rims, points)
        roots = Roots.by_nearest(np.arange(len(points)))
        faces = _faces_within(rig, self._riding)
        piece = islands(len(points), faces)
        graph = SurfaceGraph(points, faces)
        for number in range(int(piece.max(initial=-1)) + 1):
            within = np.flatnonzero(piece == number)
            reach = to_rim[within]
            small = np.ptp(points[within], axis=0).max() <= _SMALL * unit
            if reach.min() <= _OFF_RIM * unit and reach.max() <= _LASHES * unit:
                near = within[[int(reach.argmin())] if small else reach <= max(_LASH * unit, reach.min() + _ROW * unit)]
                roots.at_rim[within] = True
            elif small:
                near = within[[int(away[within].argmin())]]
            elif away[within].max() > _ON_SKIN * unit:
                near = within[away[within] <= max(_ON_SKIN * unit, 1.5 * float(away[within].min()))]
                # The wall of a mouth is no hair: rotated as the lips roll or widen, its far end would come out of the
                # chin or the nose.
                near = np.union1d(near, within[behind[within]])
                roots.walls[within] = behind[within]
                joined = within[away[within] <= _JOINED * unit]
                if roots.walls[within].any() and len(joined):
                    roots.sides[within] = sides[nearest[_nearest_along(graph, within, joined), 0]]
            else:
                continue
            roots.at[within] = _nearest_along(graph, within, near)
        return roots


def _span(rows: IntArray) -> IntArray | slice:
    """Return rows that follow each other as a slice, through which arrays are copied faster."""
    follow = len(rows) > 0 and bool((np.diff(rows) == 1).all())
    return slice(int(rows[0]), int(rows[-1]) + 1) if follow else rows


def _rims(skin: HeadRig) -> tuple[NDArray[np.intp], FloatArray]:
    """Vertices of the rims of all lids, (M,), and points all along these, (P, 3)."""
    eyes = [] if skin.faces is None else lid_rims(skin.vertices, skin.faces, skin.landmarks, skin.region_weights)
    rims = [lid.vertices[np.argsort(lid.at, kind="stable")] for eye in eyes for lid in (eye.upper, eye.lower)]
    if not rims:
        return np.empty(0, dtype=np.intp), np.empty((0, 3))
    # A coarse rim has fewer vertices than lashes that begin between them.
    share = np.linspace(0.0, 1.0, _STEPS, endpoint=False)[:, None, None]
    lines = [np.asarray(skin.vertices, dtype=np.float64)[rim] for rim in rims]
    along = [(line[:-1] + share * np.diff(line, axis=0)).reshape(-1, 3) for line in lines]
    return np.unique(np.concatenate(rims)), np.concatenate([*lines, *along])


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
