"""Editing of painted regions: mirroring and smoothing."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..face.landmarks import BROWS, EYE_RIGHT, JAW, MIRROR, outer_eye_distance
from ..mesh.nearest import NearestPoints
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray

Side = Literal["left", "right"]
"""The head's own left or right."""

_RIGHT_HALF = np.concatenate([JAW[:8], BROWS[:5], EYE_RIGHT])
_NORMAL_DISTANCE = 0.1
"""Half-distance, in outer-eye distances, that opposite normals stand for: lips that touch coincide, but face apart."""


def mirror_regions(
    vertices: FloatArray, faces: IntArray, landmarks: IntArray, weights: FloatArray, source: Side
) -> FloatArray:
    """Copy the weights of one half of a head to the other, mirrored.

    Each vertex of the other half takes the weights of the vertex whose mirror image is nearest and faces the same way.
    The plane of symmetry is that of the landmarks, so the mesh need not be symmetric or upright.

    Parameters
    ----------
    vertices, faces, landmarks, weights : (V, 3), (F, K), (66,), (3, V) array
        As in `HeadRig`.
    source : {"left", "right"}
        The half that is kept, from the head's own point of view.

    Returns
    -------
    (3, V) array
        The new weights.
    """
    place = np.asarray(vertices, dtype=np.float64)
    points = place[landmarks]
    unit = outer_eye_distance(points)
    # The plane of symmetry passes through the mean landmark, normal to the mean direction between mirrored pairs.
    to_left = (points[MIRROR[_RIGHT_HALF]] - points[_RIGHT_HALF]).sum(axis=0)
    normal = to_left / np.linalg.norm(to_left)
    height = (place - points.mean(axis=0)) @ normal
    looks = _NORMAL_DISTANCE * unit * _normals(place, faces)
    images = np.hstack([_reflected(place, height, normal), _reflected(looks, looks @ normal, normal)])
    on_source = height >= 0.0 if source == "left" else height <= 0.0
    kept, others = np.flatnonzero(on_source), np.flatnonzero(~on_source)
    nearest, _ = NearestPoints(np.hstack([place, looks])[kept]).query(images[others])
    mirrored = np.array(weights)
    mirrored[:, others] = np.asarray(weights)[:, kept[nearest[:, 0]]]
    return mirrored


def smooth_regions(vertices: FloatArray, faces: IntArray, weights: FloatArray, repeat: int = 1) -> FloatArray:
    """Smooth weights: move each halfway to the mean of its neighbours along edges.

    Lips and lids stay apart, as no edge joins them. The sum of the weights of a vertex never exceeds the largest sum
    among itself and its neighbours.

    Parameters
    ----------
    vertices, faces, weights : (V, 3), (F, K), (3, V) array
        As in `HeadRig`; any frame.
    repeat : int
        Number of passes.

    Returns
    -------
    (3, V) array
        The new weights.
    """
    edges = SurfaceGraph(vertices, faces).edges
    degree = np.bincount(edges.reshape(-1), minlength=len(vertices))
    smooth = np.array(weights, dtype=np.float64)
    for _ in range(repeat):
        around = np.array([_sums(row, edges) for row in smooth]) / np.maximum(degree, 1)
        smooth += np.where(degree > 0, 0.5 * (around - smooth), 0.0)
    return smooth.astype(np.asarray(weights).dtype)


def _sums(values: FloatArray, edges: IntArray) -> FloatArray:
    """Sum of `values` over the neighbours of each vertex, (V,)."""
    sums = np.zeros(len(values))
    for at, other in (edges.T, edges[:, ::-1].T):
        sums += np.bincount(at, values[other], len(values))
    return sums


def _reflected(vectors: FloatArray, heights: FloatArray, normal: FloatArray) -> FloatArray:
    return vectors - 2.0 * heights[:, None] * normal


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals, from the first three corners of each face, (V, 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    of_faces = np.cross(b - a, c - a)
    normals: FloatArray = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], of_faces[:, axis], len(vertices))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals
