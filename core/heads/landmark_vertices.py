"""Vertices for landmarks: on the rims of openings, on their own lips, all different, and pulled to marks (method.md,
section 7.1).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError, Message
from ..face.landmarks import (
    EYE_LEFT,
    EYE_RIGHT,
    JAW,
    LIPS,
    LOWER_LIP,
    MIRROR,
    MOUTH_CORNERS,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    NOSE,
    UPPER_LIP,
    from_ibug,
    outer_eye_distance,
    symmetry_plane,
)
from ..mesh.surface import NearestPoints, SurfaceGraph, border_twins, surface_normals
from ..numeric.arrays import FloatArray, IntArray
from .lids import eyes_joined
from .slits import lips_joined

TOO_COARSE = Message("The mesh is too coarse for 66 landmarks. Subdivide the face, or use another mesh.")
FACING = 0.3
"""Cosine of the angle between normals above which a vertex faces roughly the same way."""
ORGANS = tuple(
    (organ, tuple(int(corner) for corner in corners))
    for organ, corners in ((EYE_RIGHT, EYE_RIGHT[[0, 3]]), (EYE_LEFT, EYE_LEFT[[0, 3]]), (LIPS, MOUTH_CORNERS))
)
"""Landmarks of eyes and mouth, and their corners."""
_RIMS = np.concatenate([EYE_RIGHT, EYE_LEFT, MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
"""Landmarks that lie on the rims of openings, if the mesh has any there."""
_CORNERS = from_ibug((36, 39, 37, 41, 39, 36, 38, 40, 45, 42, 44, 46, 42, 45, 43, 47)).reshape(4, 4)
"""Corners of the eyes, each with the opposite one and the landmarks of the upper and lower lid beside it."""
_AROUND = 0.5
"""Distance from a corner, in outer-eye distances, within which a path around it is sought."""
_BACK = 0.15
"""Share of an eye's width by which such a path may first lead the other way, as faces there need not end at a lid's
landmark."""
_SHORT = 0.03
"""Distance by which a corner may fall short of where the lids meet: on a scan 0.02, on a head with deep lids 0.06."""
_FAR = 0.15
"""Distance beyond which the lids meet elsewhere, as behind the eye: half of its width."""
_TIP, _CHIN = int(NOSE[3]), int(JAW[8])
_PULL = 0.4
"""Distance from the tip of the nose, in outer-eye distances, at which its landmarks follow by 1/e of its way: that to
its root."""
_WAY = 2.5
"""Length of the way along the surface to a vertex, relative to that of the pull, up to which it is considered."""
_NOSTRILS, _MENTON = from_ibug((31, 32, 33, 34, 35)), from_ibug((7, 8, 9))
"""Landmarks above and below the mouth."""
_UPPER, _LOWER = np.concatenate([UPPER_LIP, MOUTH_INNER_UPPER]), np.concatenate([LOWER_LIP, MOUTH_INNER_LOWER])
_CROSSED = 0.015
"""Difference of two detours, in outer-eye distances, from which a vertex is certainly on one of the lips. Beside the
corners of the mouth it is smaller on both."""
_SYMMETRY = 2e-3
"""Distance, in outer-eye distances, within which places count as mirror images: twice that of a symmetric mesh."""


def onto_rims(graph: SurfaceGraph, wanted: FloatArray, landmarks: IntArray, reach: float) -> NDArray[np.intp]:
    """Move landmarks of lids and inner lips to the nearest border within `reach`, if the mesh has openings there."""
    moved = np.array(landmarks, dtype=np.intp)
    pieces = [piece for piece in graph.openings() if len(piece) < 0.5 * len(graph.vertices)]
    if not pieces:
        return moved
    border = np.concatenate(pieces)
    for i in _RIMS:
        distance = np.linalg.norm(graph.vertices[border] - wanted[i], axis=1)
        if distance.min() < reach:
            moved[i] = border[np.argmin(distance)]
    return moved


def on_own_lip(
    graph: SurfaceGraph, wanted: FloatArray, landmarks: IntArray, middle: NDArray[np.bool_] | None = None
) -> NDArray[np.intp]:
    """Move landmarks of the lips that ended on the wrong lip to their own, which is nearer along the surface.

    Nose and chin tell the lips apart first: from the wrong one, the way to them leads around a corner of the mouth.
    Then inner landmarks are compared with the outer ones. Those in the middle of a symmetric head stay among the
    vertices `middle` (V,).
    """
    moved = np.array(landmarks, dtype=np.intp)
    if lips_joined(graph, landmarks):
        return moved
    from_nose, from_chin = (_detours(graph, landmarks[seeds]) for seeds in (_NOSTRILS, _MENTON))
    least = _CROSSED * outer_eye_distance(graph.vertices[landmarks])
    for lip, own, other in ((_UPPER, from_nose, from_chin), (_LOWER, from_chin, from_nose)):
        for i in lip[own[moved[lip]] > other[moved[lip]] + least]:
            moved[i] = _nearest_within(graph, wanted[i], _kept(own < other - least, i, middle), int(moved[i]))
    landmarks = moved.copy()
    to_upper, to_lower = (graph.path_lengths(landmarks[rim].tolist()) for rim in (UPPER_LIP, LOWER_LIP))
    for inner, own, other in (
        (MOUTH_INNER_UPPER, to_upper, to_lower),
        (MOUTH_INNER_LOWER, to_lower, to_upper),
    ):
        for i in inner[own[moved[inner]] >= other[moved[inner]]]:
            moved[i] = _nearest_within(graph, wanted[i], _kept(own < other, i, middle), int(moved[i]))
    return moved


def _kept(within: NDArray[np.bool_], landmark: int, middle: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Return those of the vertices `within` (V,) to which a landmark may move."""
    return within if middle is None or MIRROR[landmark] != landmark else within & middle


def _nearest_within(graph: SurfaceGraph, wanted: FloatArray, within: NDArray[np.bool_], otherwise: int) -> int:
    """Return the vertex nearest to a place (3,) of those `within` (V,), if there are any."""
    lip = np.flatnonzero(within)
    return int(lip[np.argmin(np.linalg.norm(graph.vertices[lip] - wanted, axis=1))]) if len(lip) else otherwise


def _detours(graph: SurfaceGraph, seeds: IntArray) -> FloatArray:
    """Return by how much the way along the surface to the nearest of some vertices exceeds the straight one, (V,)."""
    straight, _ = NearestPoints(graph.vertices[seeds]).query(graph.vertices)
    straight = np.linalg.norm(graph.vertices - graph.vertices[seeds[straight[:, 0]]], axis=1)
    return np.asarray(graph.path_lengths(seeds.tolist()) - straight)


def onto_corners(graph: SurfaceGraph, faces: IntArray, landmarks: IntArray, forward: FloatArray) -> NDArray[np.intp]:
    """Move the corners of eyes that fall short of where the lids meet, on a skin that goes on behind its lids.

    The shortest path around a corner from one lid to the other hugs the place where they meet. Of its vertices that
    face `forward`, (3,), as the face does, the outermost is taken; others are behind the lids. Corners on a border
    stay, as do those of eyes that are one skin with their lids.
    """
    moved = np.array(landmarks, dtype=np.intp)
    places, unit = graph.vertices, outer_eye_distance(graph.vertices[landmarks])
    border, in_front = np.unique(graph.edges[graph.faces_at == 1]), surface_normals(places, faces) @ forward > FACING
    joined = eyes_joined(places, faces, landmarks)
    for corner, other, upper, lower in _CORNERS:
        if joined[int(corner in EYE_LEFT)] or np.isin(landmarks[[corner, upper, lower]], border).any():
            continue
        start, end = landmarks[[other, corner]]
        width = float(np.linalg.norm(places[end] - places[start]))
        outwards = (places - places[start]) @ (places[end] - places[start]) / max(width, 1e-30)
        least = float(outwards[landmarks[[upper, lower]]].min()) - _BACK * width
        near = (outwards >= least) & (np.linalg.norm(places - places[end], axis=1) < _AROUND * unit)
        around = SurfaceGraph(places, faces[(near[faces] | (faces < 0)).all(axis=1)])
        path = [v for v in around.path(int(landmarks[upper]), int(landmarks[lower])) if in_front[v]]
        last = max(path, key=lambda vertex: float(outwards[vertex]), default=int(end))
        away = float(np.linalg.norm(places[last] - places[end]))
        if outwards[last] - outwards[end] > _SHORT * unit and away < _FAR * unit:
            moved[corner] = last
    return moved


def distinct(graph: SurfaceGraph, landmarks: IntArray, picked: Mapping[int, int]) -> NDArray[np.intp]:
    """Move landmarks that share a vertex to free neighbours, or theirs, as control points have to differ.

    Marked ones stay.
    """
    spread, used = np.array(landmarks, dtype=np.intp), set()
    for i, vertex in sorted(enumerate(landmarks.tolist()), key=lambda pair: pair[0] not in picked):
        if vertex in used:
            near = graph.neighbours(vertex)
            further = [other for neighbour in near for other in graph.neighbours(neighbour)]
            free = [v for v in near if v not in used] or [v for v in further if v not in used]
            if not free:
                raise HeadError(TOO_COARSE)
            spread[i] = min(free, key=lambda v: float(np.linalg.norm(graph.vertices[v] - graph.vertices[vertex])))
        used.add(int(spread[i]))
    return spread


def pull(points: FloatArray, marked: Mapping[int, FloatArray]) -> FloatArray:
    """Return how far landmarks at points (66, 3) are pulled, (66, 3), by some that are `marked` at places (3,).

    Lids and lips move in proportion between their corners, so that an eye or the mouth keeps its height. The tip of the
    nose takes the rest of it along, and the chin the jaw line. No part moves another, as each is seen on its own.
    """
    pulled = np.zeros_like(points)
    moves = {i: goal - points[i] for i, goal in marked.items()}
    for organ, (first, last) in ORGANS:
        start, end = (moves.get(corner, np.zeros(3)) for corner in (first, last))
        along = points[last] - points[first]
        share = np.clip((points[organ] - points[first]) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
        pulled[organ] = (1.0 - share)[:, None] * start + share[:, None] * end
    if _TIP in moves:
        away = np.linalg.norm(points[NOSE] - points[_TIP], axis=1) / (_PULL * outer_eye_distance(points))
        pulled[NOSE] = np.exp(-np.square(away))[:, None] * moves[_TIP]
    if _CHIN in moves:
        pulled[JAW] = (1.0 - np.abs(np.linspace(-1.0, 1.0, len(JAW))))[:, None] * moves[_CHIN]
    for i, move in moves.items():
        pulled[i] = move
    return pulled


def pulled_to_marks(
    places: FloatArray, faces: IntArray, landmarks: IntArray, picked: Mapping[int, int], *, symmetric: bool
) -> NDArray[np.intp]:
    """Move landmarks (66,) of a mesh to the vertices that are marked, and those near them along, on the surface.

    Those of a `symmetric` head that have no mark mirror the marks of the other side. Landmarks that are not pulled
    stay. Raises HeadError if the mesh is too coarse.
    """
    points = places[landmarks]
    goals = {landmark: places[vertex] for landmark, vertex in picked.items()}
    middle = None
    if symmetric:
        centre, across = symmetry_plane(points)
        middle = np.abs((places - centre) @ across) < _SYMMETRY * outer_eye_distance(points)
        goals = _on_both_sides(points, goals)
    moves = pull(points, goals)
    found = np.array(landmarks, dtype=np.intp)
    found[list(picked)] = list(picked.values())
    led = [i for i in np.flatnonzero(np.linalg.norm(moves, axis=1) > 0.0).tolist() if i not in picked]
    if led:
        # Split at the seams of a texture, as exporters do, the skin would end there.
        twins = border_twins(places, faces)
        joined = SurfaceGraph(places, np.where(faces >= 0, twins[faces], -1))
        goal = points + moves
        reached = _walked(joined, surface_normals(places, faces), goal, twins[landmarks], led, middle)
        found[led] = np.where(reached == twins[landmarks[led]], landmarks[led], reached)
        own = on_own_lip(joined, goal, twins[found], middle)
        found = np.where(own == twins[found], found, own)
        found[list(picked)] = list(picked.values())
    return distinct(SurfaceGraph(places, faces), found, picked)


def _on_both_sides(points: FloatArray, goals: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
    """Add to the goals of marked landmarks those of their mirror images, unless these are marked as well."""
    both, (centre, across) = dict(goals), symmetry_plane(points)
    for i, goal in goals.items():
        if (other := int(MIRROR[i])) not in goals:
            image = goal - 2.0 * float((goal - centre) @ across) * across
            near = np.linalg.norm(image - points[other]) < _SYMMETRY * outer_eye_distance(points)
            both[other] = points[other] if near else image
    return both


def _walked(
    graph: SurfaceGraph,
    normals: FloatArray,
    goal: FloatArray,
    start: IntArray,
    led: list[int],
    middle: NDArray[np.bool_] | None,
) -> NDArray[np.intp]:
    """Walk along the surface from vertices `start` (66,) to those nearest to the goal (66, 3) that face the same way.

    Returns those of the landmarks `led`. Lids and lips that are on a rim stay on it, and landmarks that have no mirror
    image stay in the `middle` (V,) of a symmetric head.
    """
    border = np.zeros(len(graph.vertices), dtype=np.bool_)
    border[np.unique(graph.edges[graph.faces_at == 1])] = True
    found = []
    for i in led:
        vertex = int(start[i])
        edge = max(
            (float(np.linalg.norm(graph.vertices[v] - graph.vertices[vertex])) for v in graph.neighbours(vertex)),
            default=0.0,
        )
        length = float(np.linalg.norm(goal[i] - graph.vertices[vertex]))
        near = np.isfinite(graph.path_lengths([vertex], _WAY * length + edge))
        near &= normals @ normals[vertex] > FACING
        if i in _RIMS and border[vertex]:
            near &= border
        if middle is not None and MIRROR[i] == i and middle[vertex]:
            near &= middle
        near[vertex] = True
        reached = np.flatnonzero(near)
        found.append(int(reached[np.argmin(np.linalg.norm(graph.vertices[reached] - goal[i], axis=1))]))
    return np.array(found, dtype=np.intp)
