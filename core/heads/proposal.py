"""Proposed regions of a bound mesh, from its landmarks and openings (method.md, section 7.2).

Across a slit, from lid to lid and from lip to lip, the change is sharp and follows the distance along the surface: lips
that are closed but not joined coincide in space, yet are far apart on the skin. Elsewhere regions overlap along the
lines on which the muscles meet: from the outer corner of the eye to the temple, over the bridge of the nose, and from
the corner of the mouth to the angle of the jaw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import (
    BROWS,
    EYE_CORNERS,
    EYE_LEFT,
    EYE_RIGHT,
    LOWER_LIP,
    LOWER_LIPS,
    MOUTH_CORNERS,
    NOSE_ROOT,
    OUTER_EYE_CORNERS,
    UPPER_LIP,
    UPPER_LIPS,
    from_ibug,
    outer_eye_distance,
)
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray
from .regions import hold_landmarks

_UPPER_LIDS = EYE_RIGHT[:4], EYE_LEFT[:4]
_LOWER_LIDS = EYE_RIGHT[[3, 4, 5, 0]], EYE_LEFT[[3, 4, 5, 0]]
_RIGHT_CORNER, _LEFT_CORNER = MOUTH_CORNERS[:1], MOUTH_CORNERS[1:]
_UPPER_LIP = np.concatenate([_RIGHT_CORNER, UPPER_LIP, _LEFT_CORNER])
_LOWER_LIP = np.concatenate([_LEFT_CORNER, LOWER_LIP[::-1], _RIGHT_CORNER])
_INNER_UPPER = np.concatenate([_RIGHT_CORNER, UPPER_LIPS, _LEFT_CORNER])
_INNER_LOWER = np.concatenate([_LEFT_CORNER, LOWER_LIPS[::-1], _RIGHT_CORNER])
"""The rims of lids and lips, from corner to corner."""
_EYE_SOFTNESS = 0.08
"""Reach of the transition to either side of the line through the eyes, in outer-eye distances, far from the corners."""
_MOUTH_SOFTNESS = 0.22
"""The same for the line through the mouth."""
_SLIT_SOFTNESS = 0.002
_REACH = 0.6
_AT_CORNER = 0.025
"""In outer-eye distances: half widths of the overlaps at the eyes, the mouth and a slit, distance from a slit within
which distance along the surface decides, and width at its corners in which it does not."""


@dataclass(frozen=True)
class _Slit:
    """The sides of a slit: `share` (V,) of the upper side for each vertex, valid where `near` (V,)."""

    share: FloatArray
    near: NDArray[np.bool_]


def propose_regions(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> FloatArray:
    """Propose the weights (3, V) of the regions upper, middle and lower, 0 to 1, for arrays as in `HeadRig`.

    They sum to at most 1, and to 0 where nothing moves.
    """
    points = np.asarray(vertices, dtype=np.float64)[landmarks]
    unit = outer_eye_distance(points)
    centre = points[OUTER_EYE_CORNERS].mean(axis=0)
    place = (np.asarray(vertices, dtype=np.float64) - centre) / unit
    points = place[landmarks]
    graph = SurfaceGraph(place, faces)
    # 1. By height: smooth borders through the corners of the eyes and the mouth.
    above_eyes = _above_eyes(place, points)
    above_mouth = _above_mouth(place, points)
    # 2. Between the corners of a slit: the rim that is nearer along the surface decides.
    for upper, lower in zip(_UPPER_LIDS, _LOWER_LIDS, strict=True):
        _decide(above_eyes, _slit(graph, landmarks, [upper], [lower], place, points))
    lips = _slit(graph, landmarks, [_UPPER_LIP, _INNER_UPPER], [_LOWER_LIP, _INNER_LOWER], place, points)
    _decide(above_mouth, lips)
    # 3. Shares of the three regions, fading out at the edges of the face.
    shares = np.stack([above_eyes, (1.0 - above_eyes) * above_mouth, (1.0 - above_eyes) * (1.0 - above_mouth)])
    shares *= _moving(place, points)
    shares[shares < 0.01] = 0.0
    # 4. The vertex of each landmark follows it exactly.
    return hold_landmarks(shares, place, landmarks)


def _slit(
    graph: SurfaceGraph,
    landmarks: IntArray,
    upper: list[NDArray[np.intp]],
    lower: list[NDArray[np.intp]],
    place: FloatArray,
    points: FloatArray,
) -> _Slit:
    """Decide between the corners of a slit which rim is nearer along the surface."""
    rims = [{v for line in lines for v in _rim(graph, landmarks[line])} for lines in (upper, lower)]
    corners = rims[0] & rims[1]
    to_upper, to_lower = (graph.path_lengths(rim - corners, _REACH) for rim in rims)
    left, right = np.sort(points[upper[0][[0, -1]], 0])
    # Straight above or below a corner both rims are equally near, so the height decides there.
    between = (place[:, 0] > left + _AT_CORNER) & (place[:, 0] < right - _AT_CORNER)
    near = between & np.isfinite(to_upper) & np.isfinite(to_lower)
    share = np.full(len(place), 0.5)
    share[near] = _step(to_lower[near] - to_upper[near], -_SLIT_SOFTNESS, _SLIT_SOFTNESS)
    return _Slit(share, near)


def _rim(graph: SurfaceGraph, line: IntArray) -> list[int]:
    """Return the vertices of the path along the surface through the landmark vertices `line`."""
    return [v for a, b in zip(line[:-1].tolist(), line[1:].tolist(), strict=True) for v in graph.path(a, b)]


def _decide(above: FloatArray, slit: _Slit) -> None:
    above[slit.near] = slit.share[slit.near]


def _above_eyes(place: FloatArray, points: FloatArray) -> FloatArray:
    """Share above the line from temple to temple through the corners of the eyes and the bridge of the nose, (V,)."""
    corners = points[EYE_CORNERS]
    bridge = points[NOSE_ROOT].mean(axis=0)
    line = np.stack([corners[0] - (0.3, 0.0, 0.0), *corners[:2], bridge, *corners[2:], corners[3] + (0.3, 0.0, 0.0)])
    x = place[:, 0]
    inside = ((x > corners[0, 0]) & (x < corners[1, 0])) | ((x > corners[2, 0]) & (x < corners[3, 0]))
    # The border widens with the distance from the eyes.
    outside = np.abs(x[:, None] - corners[:, 0]).min(axis=1) * ~inside
    return _above(place, line, np.clip(0.8 * outside, _SLIT_SOFTNESS, _EYE_SOFTNESS))


def _above_mouth(place: FloatArray, points: FloatArray) -> FloatArray:
    """Share above the line from the corners of the mouth to the angles of the jaw, (V,)."""
    right, left = points[MOUTH_CORNERS]
    angle_right, angle_left = points[from_ibug((3, 4))].mean(axis=0), points[from_ibug((12, 13))].mean(axis=0)
    x = place[:, 0]
    # The border widens with the distance from the corners of the mouth.
    outside = np.maximum(np.maximum(right[0] - x, x - left[0]), 0.0)
    line = np.stack([angle_right, right, left, angle_left])
    return _above(place, line, np.clip(1.2 * outside, _SLIT_SOFTNESS, _MOUTH_SOFTNESS))


def _above(place: FloatArray, line: FloatArray, soft: FloatArray) -> FloatArray:
    """1 above the line (y is down), 0 below, with a transition of `soft` on either side."""
    height = np.interp(place[:, 0], line[:, 0], line[:, 1]) - place[:, 1]
    return _step(height / soft, -1.0, 1.0)


def _moving(place: FloatArray, points: FloatArray) -> FloatArray:
    """1 on the face, 0 on skull, ears and neck, with smooth transitions, (V,)."""
    x, y, z = place.T
    ears, chin = points[[0, 16]], points[8]
    brow = points[BROWS, 1].min()
    # Behind the ears, above the brows, below the chin, and beyond the ears; in outer-eye distances.
    side = _step(z, ears[:, 2].mean() + 0.3, ears[:, 2].mean() - 0.15)
    scalp = _step(y, brow - 0.70, brow - 0.30)
    throat = _step(y + 0.25 * (z - chin[2]), chin[1] + 0.80, chin[1] + 0.20)
    # Soft, as heads without a neck go on beyond their ears.
    beyond = np.abs(x - ears[:, 0].mean()) - np.abs(np.diff(ears[:, 0])) / 2.0
    within = _step(beyond, 0.12, -0.03)
    return np.asarray(side * scalp * throat * within)


def _step(value: FloatArray, start: float, end: float) -> FloatArray:
    """Smooth step from 0 at `start` to 1 at `end`; `start` may be the larger."""
    t = np.clip((value - start) / (end - start), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))
