"""Symmetric heads and faces: mirror images of vertices, landmarks that mirror each other (method.md, section 7.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import MIRROR, outer_eye_distance, symmetry_plane
from ..mesh.surface import NearestPoints
from ..numeric.arrays import FloatArray, IntArray

_SYMMETRY = 1e-3
"""Distance, in outer-eye distances, within which vertices count as mirror images."""
_MOST = 0.95
"""Share of the vertices of a symmetric head that have a mirror image."""
_ALONG = 0.999
"""Cosine of the angle between the direction across a face and an axis of its mesh from which they are the same."""
_EVEN = 0.02
"""Distance of mirrored vertices from the nearest ones, in eye distances, up to which they are their mirror images."""
_MOST_OF_FACE = 0.9
"""Share of the vertices of a face that have a mirror image if it is symmetric."""


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


@dataclass(frozen=True)
class Symmetry:
    """The mirror image of each sampled vertex, (S,), and the unit vector (3,) across the face."""

    images: IntArray
    across: FloatArray

    def mirrored(self, moved: FloatArray) -> FloatArray:
        """Mirror displacements (..., S, 3)."""
        images = moved[..., self.images, :]
        return np.asarray(images - 2.0 * (images @ self.across)[..., None] * self.across)


def face_images(vertices: FloatArray, landmarks: IntArray, face: IntArray) -> NDArray[np.intp] | None:
    """Find the mirror image of each vertex of a face, (F,), among them; None if the face is not symmetric.

    `vertices` is (V, 3), and `face` has the indices of those of the face.
    """
    points = vertices[landmarks]
    images, off = mirror_images(vertices[face], *symmetry_plane(points))
    return np.asarray(face[images]) if (off < _EVEN * outer_eye_distance(points)).mean() > _MOST_OF_FACE else None


def symmetry_of(vertices: FloatArray, landmarks: IntArray, sample: IntArray) -> Symmetry | None:
    """Return the symmetry of sampled vertices (S,), of which the first are the landmarks.

    Returns None if the face is not symmetric.
    """
    others = sample[len(landmarks) :]
    images = face_images(vertices, landmarks, others)
    if images is None:
        return None
    places = {int(vertex): row for row, vertex in enumerate(others.tolist(), start=len(landmarks))}
    rows = [*MIRROR.tolist(), *(places[int(image)] for image in images.tolist())]
    return Symmetry(np.array(rows, dtype=np.intp), symmetry_plane(vertices[landmarks])[1])
