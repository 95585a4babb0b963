"""Motion of a character's parts: eyes turn, lower teeth follow the jaw, lashes ride on the skin, all else stays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..deform.lid_rims import lid_rims
from ..heads.eyeballs import part_eyeball
from ..heads.rig import HeadRig, Part, Skin
from ..heads.tongues import tongue_of, tongue_out
from ..mesh.surface import NearestPoints, SurfaceGraph, islands, surface_normals
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .gums import Gums

_NEIGHBOURS = 10
_BREADTH = 0.02
"""Distance, in outer-eye distances, by which the neighbourhood of a root is wider than its distance from the skin."""
_STIFFNESS = 1e-3
"""Share of its inertia by which a neighbourhood resists rotations that it does not determine, such as about a line."""
_RIM_STIFFNESS = 1.0
"""The same share at the rim of a lid, which is such a line, beside which the skin stretches: it would kink a line of
lashes."""
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


_POSITIVE, _NEGATIVE = np.array([7, 2, 3]), np.array([5, 6, 1])
"""Where x, y and z are in [r]x, row by row, and where their negatives are."""


@dataclass(frozen=True)
class Roots:
    """What holds each of N points that ride on the skin.

    Attributes
    ----------
    at : (N,) intp
        The point at which each is rooted in the skin: for a lash, its end at the lid; itself for a point on the skin.
    at_rim : (N,) bool
        Whether the root is held only by the rims of lids.
    walls : (N,) bool
        Whether the point is shifted, but not rotated.
    sides : (N,) intp
        Side of a slit on which the root is held; -1 for that of the nearest vertex of the skin.
    """

    at: NDArray[np.intp]
    at_rim: NDArray[np.bool_]
    walls: NDArray[np.bool_]
    sides: NDArray[np.intp]

    @classmethod
    def by_nearest(cls, at: IntArray) -> Roots:
        """Roots at the points `at` (N,), which are held by the skin nearest to them."""
        no = np.zeros(len(at), dtype=np.bool_)
        return cls(np.array(at), no, no.copy(), np.full(len(at), -1))


class Glue:
    """Moves points (N, 3) with the skin (U, 3) below them, as rigidly as a lash turns with its lid.

    `sides` (U,) says on which side of a slit each vertex of the skin is: a root is held by one side only, so that an
    upper lash does not follow the lower lid. `rims` (M,) are the vertices of the skin on the rims of lids. Points and
    skin are at rest, in one frame and unit, and `unit` is the outer-eye distance in it.

    Let d_i be the displacements of the nearest vertices of the skin, r_i their positions relative to the weighted mean,
    and w_i weights. A point is rotated about the mean by the vector that fits best (equation 5.10),
    ``omega = (sum w_i (|r_i|^2 - r_i r_i^T))^-1 sum w_i r_i x d_i``, and moves with the mean. The length of omega is
    the sine of the angle, up to a right angle.
    """

    def __init__(
        self,
        points: FloatArray,
        roots: Roots,
        skin: FloatArray,
        sides: IntArray,
        unit: float,
        rims: IntArray | None = None,
    ) -> None:
        places, skin = np.asarray(points, dtype=np.float64), np.asarray(skin, dtype=np.float64)
        sides = np.asarray(sides)
        self._roots, first, self._places = np.unique(roots.at, return_index=True, return_inverse=True)
        at, rim = places[self._roots], roots.at_rim[first]
        self._rows, weights = _neighbours(at, skin, sides, unit, roots.sides[first])
        if rims is not None and rim.any():
            found, weights[rim] = _neighbours(at[rim], skin[rims], sides[rims], unit, roots.sides[first][rim])
            self._rows[rim] = rims[found]
        near = skin[self._rows]
        # Equation 5.10 at rest: weighted mean of the neighbourhood, arms r_i from it, and sum w r r^T.
        middle = np.einsum("nk,nkc->nc", weights, near)
        arms = near - middle[:, None]
        squares = np.einsum("nk,nkc,nkd->ncd", weights, arms, arms)
        # Inertia sum w (|r|^2 - r r^T), with a share of its trace on the diagonal: the rotation about a line of
        # neighbours, which they do not determine, is then held at 0.
        size = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        stiffness = np.where(rim, _RIM_STIFFNESS, _STIFFNESS)[:, None, None]
        inertia = size - squares + stiffness * size + 1e-30 * np.eye(3)
        # From displacements d_i to omega, I^-1 w_i [r_i]x, and to the shift of the mean, w_i; one matrix a root does
        # both in a frame.
        turns = np.einsum("nab,nk,nkbc->nkac", linalg.inverses_of_three(inertia), weights, _cross(arms))
        turns[roots.walls[first]] = 0.0
        shares = weights[..., None, None] * np.eye(3)
        moments = np.swapaxes(np.concatenate([shares, turns], axis=2), 1, 2)
        self._moments = moments.reshape(len(at), 6, -1).astype(np.float32)
        self._middle = middle[self._places].astype(np.float32)
        self._arms = (places - middle[self._places]).astype(np.float32)

    def tables(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the tables that `move` uses, for evaluation in another program.

        The first, (N, 4), holds the middle of the neighbourhood of each point, and the index of its root. The second,
        (R, K, 3, 4), holds, for each neighbour of each root, the matrix from its displacement to the rotation vector;
        in the fourth column, the vertex of the skin, its weight, and 0.
        """
        roots = np.zeros((*self._rows.shape, 3, 4), dtype=np.float32)
        moments = self._moments.reshape(len(roots), 6, -1, 3)
        roots[..., :3] = np.swapaxes(moments[:, 3:], 1, 2)
        roots[..., 0, 3], roots[..., 1, 3] = self._rows, moments[:, 0, :, 0]
        return np.column_stack([self._middle, self._places]).astype(np.float32), roots

    def move(self, displacements: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the moved points (..., N, 3), for displacements (..., U, 3) of the skin in its frame and unit."""
        near = displacements.take(self._rows, axis=-2)
        moved = np.einsum("nak,...nk->...na", self._moments, near.reshape(*near.shape[:-2], -1))
        turns = _rotations(moved[..., 3:]).take(self._places, axis=-3)
        shift = moved[..., :3].take(self._places, axis=-2)
        return np.asarray(self._middle + shift + np.einsum("...nab,nb->...na", turns, self._arms))


def _neighbours(
    roots: FloatArray, skin: FloatArray, sides: IntArray, unit: float, own: IntArray
) -> tuple[NDArray[np.intp], FloatArray]:
    """Find the vertices of the skin near each root and on its side, and their weights, which sum to 1, (R, K).

    The side is `own` (R,), or that of the nearest vertex if that is -1, or far away.
    """
    count = min(4 * _NEIGHBOURS, len(skin))
    rows, squared = NearestPoints(skin).query(roots, count)
    distance = np.sqrt(np.maximum(squared, 0.0)).astype(np.float64)
    side = np.where((sides[rows] == own[:, None]).any(axis=1), own, sides[rows[:, 0]])
    # Neighbours across the slit are sorted last and get weight 0; four times the number is sought, so that enough
    # remain.
    other = sides[rows] != side[:, None]
    order = np.argsort(np.where(other, np.inf, distance), axis=1, kind="stable")[:, :_NEIGHBOURS]
    rows, distance = np.take_along_axis(rows, order, axis=1), np.take_along_axis(distance, order, axis=1)
    breadth = distance[:, :1] + _BREADTH * unit
    weights = np.exp(-np.square(distance / breadth)) * ~np.take_along_axis(other, order, axis=1)
    return rows, weights / weights.sum(axis=1, keepdims=True)


def _cross(arms: FloatArray) -> FloatArray:
    """Matrices [r]x with ``[r]x d = r x d``, (..., 3, 3)."""
    x, y, z = np.moveaxis(arms, -1, 0)
    zero = np.zeros_like(x)
    return np.asarray(np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3))


def _rotations(turns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Matrices (R, 3, 3) of the rotation vectors `turns`, whose length is the sine of the angle (Rodrigues)."""
    length = np.sqrt(np.einsum("nc,nc->n", turns, turns))[:, None]
    sine = np.minimum(length, np.float32(1.0))
    axis = turns / np.maximum(length, np.float32(1e-12))
    cosine = np.sqrt(1.0 - np.square(sine))
    # R = (1 - cos) a a^T + cos 1 + sin [a]x.
    rotations = ((1.0 - cosine) * axis)[:, :, None] * axis[:, None]
    entries, axis = rotations.reshape(len(turns), 9), sine * axis
    entries[:, ::4] += cosine
    entries[:, _POSITIVE] += axis
    entries[:, _NEGATIVE] -= axis
    return np.asarray(rotations, dtype=np.float32)


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
        return Glue(points, roots, deformed.vertices, sides, rig.eye_distance, rims)

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
