"""Symmetric heads: mirror images of vertices, and landmarks that mirror each other (method.md, section 7.1)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import MIRROR
from ..mesh.surface import NearestPoints
from ..numeric.arrays import FloatArray, IntArray

_SYMMETRY = 1e-3
"""Distance, in outer-eye distances, within which vertices count as mirror images."""
_MOST = 0.95
"""Share of the vertices of a symmetric head that have a mirror image."""
_ALONG = 0.999
"""Cosine of the angle between the direction across a face and an axis of its mesh from which they are the same."""


def mirror_images(points: FloatArray, centre: FloatArray, across: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the points nearest to the mirror images of all points (N, 3), (N,), and their distances from these, (N,).

    The plane passes through `centre`, (3,), normal to the unit vector `across`, (3,).
    """
    mirrored = points - 2.0 * ((points - centre) @ across)[:, None] * across
    found, squared = NearestPoints(points).query(mirrored)
    return np.asarray(found[:, 0], dtype=np.intp), np.sqrt(squared[:, 0])


def mirror_of(places: FloatArray, rotation: FloatArray, points: FloatArray, unit: float) -> NDArray[np.intp] | None:
    """Find the mirror image of each vertex, (V,), if the mesh is symmetric about the middle of the face; else None.

    `rotation` has the axes of the face, `points` are its landmarks (66, 3), and `unit` is the outer-eye distance.
    """
    axis = int(np.argmax(np.abs(rotation[:, 0])))
    if abs(rotation[axis, 0]) < _ALONG:
        return None
    across = np.eye(3)[axis]
    middle = float(np.median(((points + points[MIRROR]) / 2.0)[:, axis]))
    for centre in (middle, 0.0):
        images, off = mirror_images(places, centre * across, across)
        if float((off < _SYMMETRY * unit).mean()) > _MOST:
            return images
    return None


def even_landmarks(
    landmarks: IntArray, mirror: NDArray[np.intp], places: FloatArray, wanted: FloatArray, picked: Mapping[int, int]
) -> NDArray[np.intp]:
    """Mirror the better side of each pair of landmarks, and move those in the middle to the middle of the mesh."""
    even = np.array(landmarks, dtype=np.intp)
    middle = np.flatnonzero(mirror == np.arange(len(mirror)))
    off = np.linalg.norm(places[landmarks] - wanted, axis=1)
    off[list(picked)] = -1.0
    for i, j in enumerate(MIRROR.tolist()):
        if i == j and len(middle) and i not in picked:
            even[i] = middle[np.argmin(np.linalg.norm(places[middle] - wanted[i], axis=1))]
        elif i < j:
            better, other = (i, j) if off[i] <= off[j] else (j, i)
            if other not in picked:
                even[other] = mirror[landmarks[better]]
    return even
