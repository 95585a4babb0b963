"""Eyes that are one skin with their lids, as a scan's are: where to cut so that the lids can shut over them.

A cut along the mesh's own edges would leave a rim of teeth that cannot meet, so edges are split where an almond through
the lids crosses them. What lies within becomes an eye on a sphere that touches the lids from behind, and the lids slide
over that (`EyeballContact`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..errors import HeadError
from ..landmarks import EYE_LEFT, EYE_RIGHT
from ..mesh.surface import JOINED, SurfaceGraph
from .eyeballs import LID
from .lips import at_shares

EYES = EYE_RIGHT, EYE_LEFT[[3, 2, 1, 0, 5, 4]]
"""Right and left eye: outer corner, upper lid, inner corner, lower lid; each other's mirror image."""
_LIDS = (1, 2, 4, 5)
_USUAL = np.array([0.76, -0.48, 0.0])
"""Bows and lean, as in `EyeOutline`: about those of labelled scans."""
_TRUST = 0.03
"""How much the usual curve counts beside two landmarks: about a quarter."""
_SPREAD, _LEAST_BOW, _MOST_LEAN = (0.2, 0.8), 0.5, 0.2
"""What landmarks can make of it: where along the eye they count, the least share of the usual bow, and the lean."""
_STEEPEST = 0.9
"""Sine of the angle beyond which two corners lie above each other."""
_WITHIN, _REACH = 0.1, 1.0
"""From an eye's corners, in its widths: nearer, or farther, a way from lid to lid may lead round an open eye."""
_FINE, _STRETCH = 0.1, 0.35
"""Longest edge about an eye that is not too coarse, and how far from it lids still stretch, in its widths."""
_SNAP = 0.15
"""Of an edge: a vertex as near to the cut as that is taken to lie on it, which saves slivers."""
_LEAST_RIM = 12
"""Vertices of a rim: fewer make no almond."""
_MIDDLE = np.array([0.5, 0.04, 0.2])
"""About where the middle of an eye lies in its own frame."""
_ALONG = (0.36, 0.68)
"""Where along an eye a lid's two landmarks lie: about there on labelled faces, 0.26 to 0.40 and 0.65 to 0.72."""
_ROUND = 0.7
"""Radius of the sphere on which lids lie, in widths of the eye: 0.01 to 0.02 off (rms) on labelled faces."""
_BESIDE, _PITS = 0.15, 95.0
"""Skin as near to the cut lies before the sphere, this percentage of it: a pit of noise does not push the eye in."""
_STEEP = 0.95
"""Share of the sphere's radius beyond which its sides are too steep to be used."""
_SPINE = (0.3, 0.7)
"""The part of an eye's middle line from which all sides lie outward."""
_HALVINGS, _STEPS = 40, 12


@dataclass(frozen=True)
class EyeOutline:
    """An almond between the corners of an eye, in the plane of its width and of the head's height.

    Attributes
    ----------
    corner : (3,) float
        The outer corner.
    axes : (3, 3) float
        Rows: unit vectors towards the inner corner, up, and towards the viewer.
    width : float
        From corner to corner.
    bows : (2,) float
    lean : float
        The height of a lid over the line from corner to corner, in widths, is s (1 - s) (bow + lean (2 s - 1)) at the
        share s of the way to the inner corner. Both lids lean the same way, as they do in people, and lie opposite
        each other in the same shares of the eye's opening, so that they meet everywhere when they shut.
    """

    corner: FloatArray
    axes: FloatArray
    width: float
    bows: FloatArray
    lean: float

    def local(self, points: FloatArray) -> FloatArray:
        """(..., 3) in widths from the outer corner: along to the inner one, up, and towards the viewer."""
        return np.asarray((points - self.corner) @ self.axes.T / self.width)

    def places(self, local: FloatArray) -> FloatArray:
        """(..., 3) in the frame of the mesh: the inverse of `local`."""
        return np.asarray(self.corner + self.width * local @ self.axes)

    def depth_within(self, local: FloatArray) -> FloatArray:
        """(...) how far a point lies within the almond, by height, in widths; below 0 outside."""
        along, up = local[..., 0], local[..., 1]
        upper, lower = (along * (1.0 - along) * (bow + self.lean * (2.0 * along - 1.0)) for bow in self.bows)
        return np.asarray(np.minimum(upper - up, up - lower))


@dataclass(frozen=True)
class EyeCut:
    """How one eye is cut out of a mesh of V vertices.

    Attributes
    ----------
    edges : (K, 2) intp
        Edges to be split, the vertex within the eye first. The new vertices are V, V + 1 and so on.
    shares : (K,) float
        Where, from the vertex within.
    chords : (C, 2) intp
        Pairs of vertices, most of them new, to be joined by an edge across the face that has both.
    rim : (N,) intp
        The closed cut, from the outer corner along the upper lid to the inner corner and back.
    inner : int
        Place of the inner corner in `rim`.
    within : (M,) intp
        Vertices of the eye that are not on the rim.
    outline : EyeOutline
    eyeball : (4,) float
        Centre and radius of the sphere that touches the lids from behind, frame of the mesh.
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
        """(6,) places in the rim, which leads through `points` (N, 3), for the landmarks of an eye in `EYES`' order."""
        # Opposite each other, so that the upper one comes down on the lower one.
        along = self.outline.local(points)[:, :1]
        upper = np.arange(self.inner + 1)
        lower = np.append(np.arange(self.inner, len(points)), 0)
        above, below = upper[at_shares(along[upper], _ALONG)], lower[at_shares(along[lower], _ALONG)]
        return np.array([0, *above, self.inner, *below])

    def on_eye(self, points: FloatArray) -> FloatArray:
        """(N, 3) points (N, 3) moved along the view of the eye onto the eye's sphere, `LID` behind the lids."""
        return self.outline.places(self._sunk(self.outline.local(points)))

    def behind_lids(self, points: FloatArray, distance: float) -> FloatArray:
        """(N, 3) on the eye's sphere, `distance` widths outside the rim, whose places are `points` (N, 3)."""
        local = self.outline.local(points)
        spine = np.zeros_like(local)
        spine[:, 0] = np.clip(local[:, 0], *_SPINE)
        spine[:, 1] = self.outline.bows.mean() / 4.0
        away = (local - spine)[:, :2]
        local[:, :2] += distance * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        return self.outline.places(self._sunk(local))

    def _sunk(self, local: FloatArray) -> FloatArray:
        centre = self.outline.local(self.eyeball[:3])
        radius = (1.0 - LID) * self.eyeball[3] / self.outline.width
        across = local[:, :2] - centre[:2]
        far = np.linalg.norm(across, axis=1, keepdims=True)
        across *= np.minimum(1.0, _STEEP * radius / np.maximum(far, 1e-9))
        depth = np.sqrt(radius**2 - np.square(across).sum(axis=1))
        return np.column_stack([centre[:2] + across, centre[2] + depth])


def eye_outline(vertices: FloatArray, landmarks: IntArray, eye: IntArray) -> EyeOutline:
    """The almond through the landmarks `eye`, one of `EYES`, of a head in the head frame with landmarks (66,).

    Both corners are met. The lids' landmarks, which lie anywhere on a mesh without rims, are met as far as two of them
    and the usual shape of eyes agree.

    Raises
    ------
    HeadError
        Where the two corners lie in one place, or one above the other.
    """
    points = np.asarray(vertices, dtype=np.float64)[landmarks[eye]]
    width = float(np.linalg.norm(points[3] - points[0]))
    along = (points[3] - points[0]) / max(width, np.finfo(float).tiny)
    if width == 0.0 or abs(along[1]) > _STEEPEST:
        raise HeadError("The two corners of an eye lie above each other. Bind the landmarks anew, or mark the corners.")
    up = along * along[1] - (0.0, 1.0, 0.0)
    up /= np.linalg.norm(up)
    towards = np.cross(along, up)
    axes = np.stack([along, up, towards if towards[2] < 0.0 else -towards])
    local = (points - points[0]) @ axes.T / width
    *bows, lean = _bows(local)
    return EyeOutline(points[0], axes, width, np.array(bows), float(lean))


def _bows(points: FloatArray) -> FloatArray:
    """(3,) `bows` and `lean` of lids with landmarks (6, 3) in an eye's own frame: least squares, drawn to the usual."""
    share = np.clip(points[_LIDS, 0], *_SPREAD)
    bow = share * (1.0 - share)
    upper = np.arange(len(_LIDS)) < 2
    terms = np.column_stack([bow * upper, bow * ~upper, bow * (2.0 * share - 1.0)])
    pull = _TRUST * np.eye(3)
    fitted = np.linalg.solve(terms.T @ terms + pull, terms.T @ points[_LIDS, 1] + pull @ _USUAL)
    upper_bow, lower_bow = _USUAL[:2] * np.maximum(fitted[:2] / _USUAL[:2], _LEAST_BOW)
    return np.array([upper_bow, lower_bow, np.clip(fitted[2], -_MOST_LEAN, _MOST_LEAN)])


def eyes_joined(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> list[bool]:
    """Whether each of `EYES` is one skin with its lids: whether the way from lid to lid leads straight over it.

    Parameters
    ----------
    vertices : (V, 3) array
        Head frame, any unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    landmarks : (66,) array of int
    """
    return [_joined(np.asarray(vertices, dtype=np.float64), np.asarray(faces), landmarks, eye) for eye in EYES]


def _joined(vertices: FloatArray, faces: IntArray, landmarks: IntArray, eye: IntArray) -> bool:
    try:
        outline = eye_outline(vertices, landmarks, eye)
    except HeadError:
        return False  # without corners there is no eye
    local = outline.local(vertices)
    along = local[:, 0]
    between = (along > _WITHIN) & (along < 1.0 - _WITHIN) & (np.abs(local[:, 1:]) < _REACH).all(axis=1)
    kept = faces[(between[faces] | (faces < 0)).all(axis=1)]
    graph = SurfaceGraph(vertices, kept)
    pairs = landmarks[eye][[[1, 5], [2, 4]]]
    told = [
        bool(np.isfinite(graph.ways([upper], JOINED * float(np.linalg.norm(vertices[upper] - vertices[lower])))[lower]))
        for upper, lower in pairs[between[pairs].all(axis=1)].tolist()
    ]
    return bool(told) and all(told)


def coarse_edges(graph: SurfaceGraph, outline: EyeOutline) -> NDArray[np.intp]:
    """(E, 2) edges about an eye that are too long for lids to roll over it."""
    ends = outline.local(graph.vertices[graph.edges])
    long = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) > _FINE
    middle = ends.mean(axis=1)
    about = (np.abs(middle[:, 0] - 0.5) < 0.5 + _STRETCH) & (np.abs(middle[:, 1:]) < 2.0 * _STRETCH).all(axis=1)
    return np.asarray(graph.edges[long & about])


def cut_eye(vertices: FloatArray, faces: IntArray, outline: EyeOutline) -> EyeCut:
    """Where the skin is cut along the almond.

    Parameters
    ----------
    vertices : (V, 3) array
        Head frame, any unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    outline : EyeOutline

    Raises
    ------
    HeadError
        Where the mesh is too coarse or has holes at the eye.

    Notes
    -----
    Nothing hangs on the order of vertices or faces: the mirror image of a mesh is cut in the mirror image of the cut.
    """
    graph = SurfaceGraph(vertices, faces)
    local = outline.local(graph.vertices)
    for snap in (_SNAP, 0.0):
        side, ends, shares = _sides(graph, outline, local, snap)
        pieces, chords = _pieces(np.asarray(faces), side, ends)
        loop = _loop(pieces)
        if loop is not None:
            break
    if not pieces or (loop is not None and len(loop) < _LEAST_RIM):
        raise HeadError("The mesh is too coarse at the eyes. Subdivide them first.")
    within = np.unique([v for piece in pieces for v in piece if side[v] > 0])
    holes = {v for edge in graph.edges[graph.faces_at == 1].tolist() for v in edge}
    if loop is None or holes.intersection(within.tolist()) or holes.intersection(loop):
        raise HeadError("The mesh has holes at the eyes. Fill them, or cut along the lids: Edge > Edge Split.")
    places = np.concatenate([local, _between(local[ends], shares)])
    rim, inner = _from_outer_corner(loop, places)
    beside = np.isfinite(graph.ways(np.unique(ends).tolist(), _BESIDE * outline.width))
    beside[within] = False
    eyeball = _sphere_behind(outline, places[rim], local[beside])
    return EyeCut(ends, shares, chords, rim, inner, within, outline, eyeball)


def _sides(
    graph: SurfaceGraph, outline: EyeOutline, local: FloatArray, snap: float
) -> tuple[IntArray, NDArray[np.intp], FloatArray]:
    """Of each vertex 1 within, 0 on the cut, -1 without; edges (K, 2) from within to without; where they are cut."""
    inside = _piece(graph, outline.depth_within(local) > 0.0, local)
    first, second = graph.edges[inside[graph.edges].sum(axis=1) == 1].T
    ends = np.asarray(np.where(inside[first], [first, second], [second, first]).T, dtype=np.intp)
    shares = _crossings(outline, local[ends])
    side = np.where(inside, 1, -1)
    side[ends[shares < snap, 0]] = 0
    side[ends[shares > 1.0 - snap, 1]] = 0
    side[(side > 0) & ~_piece(graph, side > 0, local)] = -1
    crossed = (side[ends] != 0).all(axis=1) & (side[ends[:, 0]] != side[ends[:, 1]])
    ends, shares = ends[crossed], shares[crossed]
    return np.concatenate([side, np.zeros(len(ends), dtype=side.dtype)]), ends, shares


def _piece(graph: SurfaceGraph, among: NDArray[np.bool_], local: FloatArray) -> NDArray[np.bool_]:
    """(V,) the vertices `among` (V,) that edges join to the one of them that is next to the middle of the eye."""
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
    """(K,) shares at which edges, of which (K, 2, 3) are the ends within and without, cross the almond; by halving."""
    low, high = np.zeros(len(ends)), np.ones(len(ends))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        within = outline.depth_within(_between(ends, middle)) > 0.0
        low, high = np.where(within, middle, low), np.where(within, high, middle)
    return np.asarray(0.5 * (low + high))


def _between(ends: FloatArray, shares: FloatArray) -> FloatArray:
    """(K, 3) places on edges (K, 2, 3) at `shares` (K,) of the way from the first end to the second."""
    return np.asarray(ends[:, 0] + shares[:, None] * (ends[:, 1] - ends[:, 0]))


def _pieces(faces: IntArray, side: IntArray, ends: IntArray) -> tuple[list[list[int]], NDArray[np.intp]]:
    """The parts of faces that lie within, as lists of vertices, and the chords (C, 2) that part them from the rest."""
    new = {frozenset(pair): len(side) - len(ends) + i for i, pair in enumerate(ends.tolist())}
    pieces, chords = [], []
    for face in faces[((side[faces] > 0) & (faces >= 0)).any(axis=1)].tolist():
        corners = [v for v in face if v >= 0]
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
    """The border of `pieces`, vertex by vertex; None where it is not one closed line."""
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
    """The loop begun at the outer corner and led along the upper lid, and the place of the inner corner in it."""
    first = int(np.argmin(places[loop, 0]))
    rim = np.array(loop[first:] + loop[:first], dtype=np.intp)
    inner = int(np.argmax(places[rim, 0]))
    if places[rim[:inner], 1].mean() < places[rim[inner:], 1].mean():
        return np.array([rim[0], *rim[:0:-1]], dtype=np.intp), len(rim) - inner
    return rim, inner


def _sphere_behind(outline: EyeOutline, rim: FloatArray, skin: FloatArray) -> FloatArray:
    """(4,) centre and radius of the sphere on which the `rim` lies best, drawn back behind the `skin` beside it.

    Gauss-Newton steps for the centre; of a rim alone, which is nearly flat, no radius could be told.
    """
    centre = np.array([0.5, 0.2, -0.45])
    for _ in range(_STEPS):
        away = rim - centre
        far = np.linalg.norm(away, axis=1)
        centre = centre + np.linalg.lstsq(away / far[:, None], far - _ROUND, rcond=None)[0]
    across = np.linalg.norm(skin[:, :2] - centre[:2], axis=1)
    over = across < _STEEP * _ROUND
    before = centre[2] + np.sqrt(_ROUND**2 - across[over] ** 2) - skin[over, 2]
    centre[2] -= max(0.0, float(np.percentile(before, _PITS)))
    return np.array([*outline.places(centre), _ROUND * outline.width])
