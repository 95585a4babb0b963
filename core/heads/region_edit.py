"""Regions after painting: one half of the face like the other, and softer borders."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..arrays import FloatArray, IntArray
from ..landmarks import BROWS, EYE_RIGHT, JAW, MIRROR, outer_eye_distance
from ..mesh.nearest import NearestPoints
from ..mesh.surface import SurfaceGraph

Side = Literal["left", "right"]
"""The head's own left or right."""

_RIGHT_HALF = np.concatenate([JAW[:8], BROWS[:5], EYE_RIGHT])
_KD_TREE_SINGLE = 4
_NORMALS = 0.1
"""Lips that touch lie in one place and look apart: eye distances that opposite normals stand for, halved."""


def mirror_regions(
    vertices: FloatArray, faces: IntArray, landmarks: IntArray, weights: FloatArray, source: Side
) -> FloatArray:
    """(3, V) weights with the half `source` as it is, and the other half as its mirror image.

    Each vertex of the other half takes the weights of the vertex whose mirror image is nearest and looks the same way;
    the plane of symmetry is that of the landmarks, so that the mesh need neither be symmetric nor stand straight.

    Parameters
    ----------
    vertices : (V, 3) array
        Head frame, any unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    landmarks : (66,) array of int
    weights : (3, V) array
    source : {"left", "right"}
    """
    place = np.asarray(vertices, dtype=np.float64)
    points = place[landmarks]
    unit = outer_eye_distance(points)
    to_left = (points[MIRROR[_RIGHT_HALF]] - points[_RIGHT_HALF]).sum(axis=0)
    normal = to_left / np.linalg.norm(to_left)
    height = (place - points.mean(axis=0)) @ normal
    looks = _NORMALS * unit * _normals(place, faces)
    images = np.hstack([_reflected(place, height, normal), _reflected(looks, looks @ normal, normal)])
    on_source = height >= 0.0 if source == "left" else height <= 0.0
    kept, others = np.flatnonzero(on_source), np.flatnonzero(~on_source)
    nearest, _ = NearestPoints(np.hstack([place, looks])[kept]).query(images[others])
    mirrored = np.array(weights)
    mirrored[:, others] = np.asarray(weights)[:, kept[nearest[:, 0]]]
    return mirrored


def smooth_regions(vertices: FloatArray, faces: IntArray, weights: FloatArray, repeat: int = 1) -> FloatArray:
    """(3, V) weights, each halfway to the mean of its neighbours along edges, `repeat` times.

    Lips and lids stay apart, as no edge joins them. The sum of the three at a vertex never grows beyond the largest
    around it.
    """
    edges = SurfaceGraph(vertices, faces).edges
    degree = np.bincount(edges.reshape(-1), minlength=len(vertices))
    smooth = np.array(weights, dtype=np.float64)
    for _ in range(repeat):
        around = np.array([_sums(row, edges) for row in smooth]) / np.maximum(degree, 1)
        smooth += np.where(degree > 0, 0.5 * (around - smooth), 0.0)
    return smooth.astype(np.asarray(weights).dtype)


def _sums(values: FloatArray, edges: IntArray) -> FloatArray:
    """(V,) sum of the values of each vertex's neighbours."""
    sums = np.zeros(len(values))
    for at, other in (edges.T, edges[:, ::-1].T):
        sums += np.bincount(at, values[other], len(values))
    return sums


def _reflected(vectors: FloatArray, heights: FloatArray, normal: FloatArray) -> FloatArray:
    return vectors - 2.0 * heights[:, None] * normal


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(V, 3) unit normals, of the first three corners of each face."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    of_faces = np.cross(b - a, c - a)
    normals: FloatArray = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], of_faces[:, axis], len(vertices))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals
