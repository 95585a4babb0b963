"""Mouths without an inside: lips whose inner rim is a border of the mesh, with nothing behind it (method.md, section
7.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import MOUTH_CORNERS, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, outer_eye_distance
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray

_INNER = np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
_BESIDE = 0.3
"""Distance of the middle of a border from that of the lips, in widths of the mouth; on ten heads up to 0.06."""
_BEHIND = 0.25
"""Largest mean distance of a border behind the lips, in outer-eye distances; on ten heads up to 0.11. The inside of a
mouth ends farther back."""
_WIDTHS = (0.5, 1.4)
"""Range of the width of a border, in widths of the mouth; on ten heads 0.86 to 1.04."""
_ROOM = np.array([0.35, 0.3, 0.9])
"""Where the inside of a mouth lies: distance to the side and in height, in widths of the mouth, and behind the lips, in
outer-eye distances."""
_FRONT = 0.02
"""Distance behind the lips at which it begins."""
_FEW = 5
"""Vertices in that room up to which there is no inside; on heads without one up to 2, on others 37 and more."""


def hollow_rim(graph: SurfaceGraph, landmarks: IntArray, others: FloatArray) -> NDArray[np.intp]:
    """Return the border (N,) along the lips of a skin if nothing is behind it; otherwise it is empty.

    The landmarks (66,) are vertices of the graph, and `others` (M, 3) the vertices of all other parts of the head, both
    in the head frame.
    """
    points = graph.vertices[landmarks]
    unit, middle = outer_eye_distance(points), points[_INNER].mean(axis=0)
    width = float(np.ptp(points[MOUTH_CORNERS][:, 0]))
    nothing = np.empty(0, dtype=np.intp)
    if width <= 0.0:
        return nothing
    away = np.asarray(others).reshape(-1, 3) - middle
    inside = (np.abs(away[:, :2]) < _ROOM[:2] * width).all(axis=1)
    inside &= (away[:, 2] > _FRONT * unit) & (away[:, 2] < _ROOM[2] * unit)
    if inside.sum() > _FEW:
        return nothing
    for border in graph.openings():
        places = graph.vertices[border] - middle
        centred = np.linalg.norm(places[:, :2].mean(axis=0)) < _BESIDE * width
        near = -_BEHIND * unit < places[:, 2].mean() < _BEHIND * unit
        if centred and near and _WIDTHS[0] * width < np.ptp(places[:, 0]) < _WIDTHS[1] * width:
            return border
    return nothing
