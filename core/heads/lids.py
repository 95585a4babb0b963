"""Opening of eyes that are one skin with their lids, as on a scan: where to cut (method.md, section 7.4).

A cut along existing edges would leave jagged rims that cannot meet. Edges are therefore split where they cross an
almond through the lids. The skin inside becomes an eye on a sphere that touches the lids from behind, and the lids
slide over it (`EyeballContact`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..mesh.surface import SurfaceGraph
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .eyeballs import EYES, LID_THICKNESS, EyeOutline, eye_outline
from .slits import JOINED, nearest_at_shares

_MARGIN = 0.1
"""Margin, in eye widths, at the corners of the part of the mesh in which paths from lid to lid are sought. Outside of
it a path might lead around an open eye."""
_REACH = 1.0
"""Extent of that part in eye widths."""
_MAX_EDGE = 0.1
"""Longest edge near an eye, in eye widths, over which lids can roll."""
_STRETCH = 0.35
"""Distance from the eye, in eye widths, up to which lids stretch."""
_SNAP = 0.15
"""Share of an edge within which a vertex is moved onto the cut, which avoids slivers."""
_MIN_RIM = 12
"""Smallest number of vertices of a rim that can follow an almond."""
_MIDDLE = np.array([0.5, 0.04, 0.2])
"""Approximate middle of an eye in its own frame."""
_LID_SHARES = (0.36, 0.68)
"""Positions of the two landmarks of a lid along the eye; 0.26 to 0.40 and 0.65 to 0.72 on labelled faces."""
_RADIUS = 0.7
"""Radius of the sphere on which lids lie, in eye widths; lids of labelled faces lie within 0.01 to 0.02 of it (rms)."""
_BESIDE = 0.15
"""Distance from the cut, in eye widths, of skin that has to lie in front of the sphere."""
_FRONT_PERCENT = 95.0
"""Percentage of that skin; below 100 so that a noisy pit does not push the eye inwards."""
_STEEP = 0.95
"""Share of the sphere's radius beyond which its sides are too steep to be used."""
_SPINE = (0.3, 0.7)
"""The part of an eye's middle line from which outward directions are measured."""
_HALVINGS = 40
"""Number of bisections of an edge."""
_STEPS = 12
"""Number of Gauss-Newton steps for the sphere."""


@dataclass(frozen=True)
class EyeCut:
    """The cut of an eye out of a mesh with V vertices.

    Attributes
    ----------
    edges : (K, 2) intp
        Edges to split, the vertex inside the eye first. The new vertices are V, V + 1 and so on.
    shares : (K,) float
        Where to split them, as a share of the edge from the inside vertex.
    chords : (C, 2) intp
        Pairs of vertices, most of them new, to be joined by an edge across the face that contains both.
    rim : (N,) intp
        Vertices of the closed cut, from the outer corner along the upper lid to the inner corner and back.
    inner : int
        Index of the inner corner in `rim`.
    within : (M,) intp
        Vertices inside the cut.
    outline : EyeOutline
        The almond.
    eyeball : (4,) float
        Centre and radius of the sphere that touches the lids from behind, in the frame of the mesh.
    """

    edges: NDArray[np.intp]
    shares: FloatArray
    chords: NDArray[np.intp]
    rim: NDArray[np.intp]
    inner: int
    within: NDArray[np.intp]
    outline: EyeOutline
    eyeball: FloatArray

    def landmark_places(self, points: FloatArray) -> NDArray[np.intp]:
        """Return the indices into the rim, at `points` (N, 3), of an eye's landmarks, (6,), ordered as in `EYES`."""
        # Landmarks of both lids at the same shares, so that upper and lower ones meet.
        along = self.outline.to_local(points)[:, :1]
        upper = np.arange(self.inner + 1)
        lower = np.append(np.arange(self.inner, len(points)), 0)
        above, below = (
            upper[nearest_at_shares(along[upper], _LID_SHARES)],
            lower[nearest_at_shares(along[lower], _LID_SHARES)],
        )
        return np.array([0, *above, self.inner, *below])

    def project_to_eye(self, points: FloatArray) -> FloatArray:
        """Move `points` (N, 3) along the viewing direction onto the sphere of the eye, behind the lids."""
        return self.outline.from_local(self._onto_sphere(self.outline.to_local(points)))

    def behind_lids(self, points: FloatArray, distance: float) -> FloatArray:
        """Return points (N, 3) on the sphere of the eye, outside the points of its rim by a distance in eye widths."""
        local = self.outline.to_local(points)
        # Outward from the nearest point of the eye's middle line.
        spine = np.zeros_like(local)
        spine[:, 0] = np.clip(local[:, 0], *_SPINE)
        spine[:, 1] = self.outline.bows.mean() / 4.0
        away = (local - spine)[:, :2]
        local[:, :2] += distance * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        return self.outline.from_local(self._onto_sphere(local))

    def _onto_sphere(self, local: FloatArray) -> FloatArray:
        centre = self.outline.to_local(self.eyeball[:3])
        radius = (1.0 - LID_THICKNESS) * self.eyeball[3] / self.outline.width
        across = local[:, :2] - centre[:2]
        far = np.linalg.norm(across, axis=1, keepdims=True)
        # Where the sphere is too steep, stay at its edge.
        across *= np.minimum(1.0, _STEEP * radius / np.maximum(far, 1e-9))
        depth = np.sqrt(radius**2 - np.square(across).sum(axis=1))
        return np.column_stack([centre[:2] + across, centre[2] + depth])


def eyes_joined(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> list[bool]:
    """Return for each of `EYES` whether it is one skin with its lids, so that paths from lid to lid cross it.

    Arrays are as in `HeadRig`.
    """
    return [_joined(np.asarray(vertices, dtype=np.float64), np.asarray(faces), landmarks, eye) for eye in EYES]


def _joined(vertices: FloatArray, faces: IntArray, landmarks: IntArray, eye: IntArray) -> bool:
    try:
        outline = eye_outline(vertices, landmarks, eye)
    except HeadError:
        return False  # without distinct corners there is no eye
    local = outline.to_local(vertices)
    along = local[:, 0]
    between = (along > _MARGIN) & (along < 1.0 - _MARGIN) & (np.abs(local[:, 1:]) < _REACH).all(axis=1)
    # A graph of the skin between the corners only; on open eyes it has no path from lid to lid.
    kept = faces[(between[faces] | (faces < 0)).all(axis=1)]
    graph = SurfaceGraph(vertices, kept)
    pairs = landmarks[eye][[[1, 5], [2, 4]]]
    joined = [
        bool(
            np.isfinite(
                graph.path_lengths([upper], JOINED * float(np.linalg.norm(vertices[upper] - vertices[lower])))[lower]
            )
        )
        for upper, lower in pairs[between[pairs].all(axis=1)].tolist()
    ]
    return bool(joined) and all(joined)


def coarse_edges(graph: SurfaceGraph, outline: EyeOutline) -> NDArray[np.intp]:
    """Find the edges (E, 2) near an eye that are too long for lids to roll over it."""
    ends = outline.to_local(graph.vertices[graph.edges])
    long = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) > _MAX_EDGE
    middle = ends.mean(axis=1)
    about = (np.abs(middle[:, 0] - 0.5) < 0.5 + _STRETCH) & (np.abs(middle[:, 1:]) < 2.0 * _STRETCH).all(axis=1)
    return np.asarray(graph.edges[long & about])


def cut_eye(vertices: FloatArray, faces: IntArray, outline: EyeOutline) -> EyeCut:
    """Find where to cut the skin along an almond; raises HeadError if the mesh is too coarse there, or has holes.

    The result does not depend on the order of vertices or faces, and the cut of a mirrored mesh is the mirrored cut.
    """
    graph = SurfaceGraph(vertices, faces)
    local = outline.to_local(graph.vertices)
    # 1. Cut edges and faces along the almond. If snapping breaks the loop, cut without it.
    for snap in (_SNAP, 0.0):
        side, ends, shares = _sides(graph, outline, local, snap)
        pieces, chords = _pieces(np.asarray(faces), side, ends)
        loop = _loop(pieces)
        if loop is not None:
            break
    if not pieces or (loop is not None and len(loop) < _MIN_RIM):
        raise HeadError("The mesh is too coarse at the eyes. Subdivide them first.")
    # 2. The eye, which must not contain or touch a hole.
    within = np.unique([v for piece in pieces for v in piece if side[v] > 0])
    holes = {v for edge in graph.edges[graph.faces_at == 1].tolist() for v in edge}
    if loop is None or holes.intersection(within.tolist()) or holes.intersection(loop):
        raise HeadError("The mesh has holes at the eyes. Fill them, or cut along the lids: Edge > Edge Split.")
    # 3. The rim in order, and the sphere behind it and the skin beside it.
    places = np.concatenate([local, _between(local[ends], shares)])
    rim, inner = _from_outer_corner(loop, places)
    beside = np.isfinite(graph.path_lengths(np.unique(ends).tolist(), _BESIDE * outline.width))
    beside[within] = False
    eyeball = _sphere_behind(outline, places[rim], local[beside])
    return EyeCut(ends, shares, chords, rim, inner, within, outline, eyeball)


def _sides(
    graph: SurfaceGraph, outline: EyeOutline, local: FloatArray, snap: float
) -> tuple[IntArray, NDArray[np.intp], FloatArray]:
    """Classify vertices as inside (1), on the cut (0) or outside (-1); also the edges to split, (K, 2), from inside to
    outside, and where to split them, (K,).
    """
    joined = np.isin(np.arange(len(local)), graph.edges)
    inside = _piece(graph, joined & (outline.depth_within(local) > 0.0), local)
    first, second = graph.edges[inside[graph.edges].sum(axis=1) == 1].T
    ends = np.asarray(np.where(inside[first], [first, second], [second, first]).T, dtype=np.intp)
    shares = _crossings(outline, local[ends])
    # Snap vertices to the cut, then drop those that this has separated from the eye.
    side = np.where(inside, 1, -1)
    side[ends[shares < snap, 0]] = 0
    side[ends[shares > 1.0 - snap, 1]] = 0
    side[(side > 0) & ~_piece(graph, side > 0, local)] = -1
    crossed = (side[ends] != 0).all(axis=1) & (side[ends[:, 0]] != side[ends[:, 1]])
    ends, shares = ends[crossed], shares[crossed]
    return np.concatenate([side, np.zeros(len(ends), dtype=side.dtype)]), ends, shares


def _piece(graph: SurfaceGraph, among: NDArray[np.bool_], local: FloatArray) -> NDArray[np.bool_]:
    """Mark the connected piece of the vertices `among` (V,) that contains the one nearest to the middle of the eye."""
    found = np.zeros(len(among), dtype=np.bool_)
    rows = np.flatnonzero(among)
    if not len(rows):
        return found
    start = rows[np.argmin(np.linalg.norm(local[rows] - _MIDDLE, axis=1))]
    waiting = [int(start)]
    while waiting:
        vertex = waiting.pop()
        if among[vertex] and not found[vertex]:
            found[vertex] = True
            waiting += graph.neighbours(vertex)
    return found


def _crossings(outline: EyeOutline, ends: FloatArray) -> FloatArray:
    """Find the shares, (K,), at which edges with ends (K, 2, 3), inside and outside, cross the almond, by bisection."""
    low, high = np.zeros(len(ends)), np.ones(len(ends))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        within = outline.depth_within(_between(ends, middle)) > 0.0
        low, high = np.where(within, middle, low), np.where(within, high, middle)
    return np.asarray(0.5 * (low + high))


def _between(ends: FloatArray, shares: FloatArray) -> FloatArray:
    """Points on edges (K, 2, 3) at `shares` (K,) of the way from the first end to the second, (K, 3)."""
    return np.asarray(ends[:, 0] + shares[:, None] * (ends[:, 1] - ends[:, 0]))


def _pieces(faces: IntArray, side: IntArray, ends: IntArray) -> tuple[list[list[int]], NDArray[np.intp]]:
    """Return the parts of faces that lie inside, as lists of vertices, and the chords (C, 2) that bound them."""
    new = {frozenset(pair): len(side) - len(ends) + i for i, pair in enumerate(ends.tolist())}
    pieces, chords = [], []
    for face in faces[((side[faces] > 0) & (faces >= 0)).any(axis=1)].tolist():
        corners = [v for v in face if v >= 0]
        # The face with the new vertices on its split edges; the vertices that are not outside form the piece.
        ring: list[int] = []
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            ring += [a, new[frozenset((a, b))]] if frozenset((a, b)) in new else [a]
        piece = [v for v in ring if side[v] >= 0]
        pieces.append(piece)
        neighbours = set(zip(ring, ring[1:] + ring[:1], strict=True))
        joined = zip(piece, piece[1:] + piece[:1], strict=True)
        chords += [pair for pair in joined if pair not in neighbours]
    return pieces, np.array(chords, dtype=np.intp).reshape(-1, 2)


def _loop(pieces: list[list[int]]) -> list[int] | None:
    """Return the border of `pieces`, vertex by vertex, or None if it is not a single closed line."""
    count: dict[frozenset[int], int] = {}
    for piece in pieces:
        for pair in zip(piece, piece[1:] + piece[:1], strict=True):
            count[frozenset(pair)] = count.get(frozenset(pair), 0) + 1
    beside: dict[int, list[int]] = {}
    for edge in (edge for edge, times in count.items() if times == 1):
        for a, b in permutations(edge):
            beside.setdefault(a, []).append(b)
    if not beside or any(len(pair) != 2 for pair in beside.values()):
        return None
    loop = [min(beside)]
    while True:
        following = [v for v in beside[loop[-1]] if v not in loop[-2:]]
        if not following or following[0] == loop[0]:
            break
        loop.append(following[0])
    return loop if len(loop) == len(beside) else None


def _from_outer_corner(loop: list[int], places: FloatArray) -> tuple[NDArray[np.intp], int]:
    """Return the loop from the outer corner along the upper lid, and the index of the inner corner in it."""
    first = int(np.argmin(places[loop, 0]))
    rim = np.array(loop[first:] + loop[:first], dtype=np.intp)
    inner = int(np.argmax(places[rim, 0]))
    if places[rim[:inner], 1].mean() < places[rim[inner:], 1].mean():
        return np.array([rim[0], *rim[:0:-1]], dtype=np.intp), len(rim) - inner
    return rim, inner


def _sphere_behind(outline: EyeOutline, rim: FloatArray, skin: FloatArray) -> FloatArray:
    """Fit the centre and radius, (4,), of the sphere through the `rim`, moved back behind the `skin` beside it.

    The radius is fixed, as it cannot be estimated from a rim, which is nearly flat. The centre is found by Gauss-Newton
    steps.
    """
    centre = np.array([0.5, 0.2, -0.45])
    for _ in range(_STEPS):
        away = rim - centre
        far = np.linalg.norm(away, axis=1)
        centre = centre + linalg.lstsq(away / far[:, None], far - _RADIUS)[0]
    # Move back until most of the skin lies in front of the sphere.
    across = np.linalg.norm(skin[:, :2] - centre[:2], axis=1)
    over = across < _STEEP * _RADIUS
    before = centre[2] + np.sqrt(_RADIUS**2 - across[over] ** 2) - skin[over, 2]
    centre[2] -= max(0.0, float(np.percentile(before, _FRONT_PERCENT)))
    return np.array([*outline.from_local(centre), _RADIUS * outline.width])
