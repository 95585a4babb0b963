"""Connected pieces of a mesh, and coincident vertices such as those at the seams of a texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray, IntArray
from .surface import SurfaceGraph

_SAME_PLACE = 1e-6
"""Share of the mesh's size within which vertices coincide."""


def border_twins(vertices: FloatArray, faces: IntArray, apart: IntArray | None = None) -> NDArray[np.intp]:
    """Find coincident vertices of open borders, where a skin was split, as exporters do at texture seams.

    Parameters
    ----------
    vertices : (V, 3) array
        Any frame and unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    apart : (N,) array of int, optional
        Vertices of borders that are openings, such as lips that were cut apart.

    Returns
    -------
    (V,) intp
        For each vertex the first of those that coincide with it. Vertices inside the mesh are not joined, as another
        layer may touch them.
    """
    graph = SurfaceGraph(vertices, faces)
    border = np.setdiff1d(graph.edges[graph.faces_at == 1], [] if apart is None else apart)
    first = np.arange(len(graph.vertices))
    if len(border):
        extent = max(float(np.ptp(graph.vertices, axis=0).max()), 1e-30)
        places = np.round(graph.vertices[border] / (_SAME_PLACE * extent)).astype(np.int64)
        _, leader, group = np.unique(places, axis=0, return_index=True, return_inverse=True)
        first[border] = border[leader[group.reshape(-1)]]
    return first


def islands(count: int, faces: IntArray, twins: IntArray | None = None) -> NDArray[np.intp]:
    """Number the connected pieces of a mesh.

    Parameters
    ----------
    count : int
        Number of vertices.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    twins : (V,) array of int, optional
        As returned by `border_twins`; pieces are connected across twins.

    Returns
    -------
    (V,) intp
        Number of the piece of each vertex, from 0. A vertex without faces is a piece of its own.
    """
    corners = np.where(faces >= 0, faces, faces[:, :1]).astype(np.intp)
    label = np.arange(count) if twins is None else np.array(twins, dtype=np.intp)
    root = label[label]
    while True:
        # Union by propagation: each face takes its lowest label, each vertex the lowest of its faces, and each label
        # the label of the vertex that it names.
        low = root[corners].min(axis=1) if len(corners) else np.empty(0, dtype=np.intp)
        new = root.copy()
        np.minimum.at(new, corners.ravel(), np.repeat(low, corners.shape[1]))
        np.minimum.at(new, root, new.copy())
        np.minimum.at(new, label, new.copy())
        new = np.minimum(new, new[label])
        new = new[new]
        if np.array_equal(new, root):
            break
        root = new
    return np.asarray(np.unique(root, return_inverse=True)[1].reshape(-1), dtype=np.intp)
