"""Landmarks of brows that are pieces of their own, such as those of an anime figure (method.md, section 7.1).

A tracker that was trained on people mistakes the fold of a large drawn eye for its brow. The name of a separate piece
tells where the brow is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, UPPER_LIDS, from_ibug, outer_eye_distance
from ..mesh.surface import NearestPoints, edges_of, surface_normals
from ..numeric.arrays import FloatArray, IntArray

_SIDES = (BROWS[:5], EYE_RIGHT), (BROWS[:4:-1], EYE_LEFT)
"""Landmarks of the brow of each side, the outer end first, and of the eye below it."""
_SHARES = np.array([0.04, 0.27, 0.5, 0.73, 0.96])
"""Positions of the landmarks along a brow, from the outer to the inner end."""
_ASIDE = 0.02
"""Distance above or below a brow, in outer-eye distances, beyond which most of its landmarks count as misplaced. On
an anime figure, landmarks on the fold of the eyes were 0.037 and 0.051 below the brows."""
_NEAR = 0.12
"""Distance from a brow, in outer-eye distances, within which it rides on the skin."""
_CANDIDATES = 12
"""Number of nearest vertices among which one for a landmark is sought that no other has."""
_FACING = 0.3
"""Smallest share of the normal of skin below a brow that points to the viewer."""


def place_on_brows(
    skin: FloatArray, skin_faces: IntArray, landmarks: IntArray, brows: FloatArray, brow_faces: IntArray
) -> NDArray[np.intp]:
    """Return the landmarks, (66,), with those that lie beside a brow moved to the skin below it.

    The vertices (V, 3) of the skin, of which the landmarks are indices, and (B, 3) of the pieces of the brows are
    upright and facing the viewer, in the head frame. A brow that is far from the skin, or is not above its eye, is
    ignored.
    """
    points = np.asarray(skin, dtype=np.float64)[landmarks]
    unit, moved = outer_eye_distance(points), np.array(landmarks, dtype=np.intp)
    ends = np.asarray(brows, dtype=np.float64)[edges_of(brow_faces)]
    middle = float(points[from_ibug([27]), 0].mean())
    front = np.flatnonzero(surface_normals(np.asarray(skin, dtype=np.float64), skin_faces)[:, 2] < -_FACING)
    for line, eye in _SIDES:
        outwards = float(np.sign(points[eye, 0].mean() - middle))
        own = ends[outwards * (ends[:, :, 0].mean(axis=1) - middle) > 0.0]
        if not len(own) or not len(front) or _beside(own, points[line]) < _ASIDE * unit:
            continue
        wanted = _along(own, outwards)
        if wanted[1:4, 1].max() > points[np.intersect1d(eye, UPPER_LIDS), 1].mean():
            continue
        taken = set(np.delete(moved, line).tolist())
        near, squared = NearestPoints(skin[front]).query(wanted, min(_CANDIDATES, len(front)))
        found: list[int] = []
        for row, away in zip(front[near], squared, strict=True):
            free = [v for v, d in zip(row.tolist(), away, strict=True) if d < (_NEAR * unit) ** 2 and v not in taken]
            found += free[:1]
            taken.update(free[:1])
        if len(found) == len(line):
            moved[line] = found
    return moved


def _beside(edges: FloatArray, points: FloatArray) -> float:
    """Return the median distance of points (N, 3) above or below a brow with edges (E, 2, 3)."""
    low, high = edges[:, :, 0].min(), edges[:, :, 0].max()
    bands = [_band(edges, float(x)) for x in np.clip(points[:, 0], low, high)]
    beside = [max(top - y, y - bottom) for y, (top, bottom, _) in zip(points[:, 1], bands, strict=True)]
    return float(np.median(beside))


def _along(edges: FloatArray, outwards: float) -> FloatArray:
    """Return the places (5, 3) of the landmarks of a brow with edges (E, 2, 3), which ends at the side `outwards`."""
    across = outwards * edges[:, :, 0]
    at = outwards * (across.max() + _SHARES * (across.min() - across.max()))
    bands = np.array([_band(edges, float(x)) for x in at])
    return np.column_stack([at, bands[:, :2].mean(axis=1), bands[:, 2]])


def _band(edges: FloatArray, x: float) -> tuple[float, float, float]:
    """Return top, bottom and depth of edges (E, 2, 3) at a vertical line; of the nearest edge if none crosses it."""
    start, end = edges[:, 0], edges[:, 1]
    crossing = (start[:, 0] - x) * (end[:, 0] - x) <= 0.0
    if not crossing.any():
        crossing[np.argmin(np.abs(edges[:, :, 0].mean(axis=1) - x))] = True
    start, end = start[crossing], end[crossing]
    run = end[:, 0] - start[:, 0]
    share = np.clip(np.where(run == 0.0, 0.5, (x - start[:, 0]) / np.where(run == 0.0, 1.0, run)), 0.0, 1.0)
    places = start + share[:, None] * (end - start)
    return float(places[:, 1].min()), float(places[:, 1].max()), float(places[:, 2].mean())
