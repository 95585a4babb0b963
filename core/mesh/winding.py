"""Which side of a mesh is its outside: exporters, mirrored objects and modelling leave faces the wrong way round."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray, IntArray
from .surface import connected, triangulate

_Number = TypeVar("_Number", bound=np.generic)


def inside_out(vertices: FloatArray, faces: IntArray) -> NDArray[np.bool_]:
    """Find the faces to turn over so that neighbours agree and the mesh encloses its middle from outside, (F,).

    Pieces whose faces agree keep their side, as the inside of a mouth faces inwards, unless the whole mesh is inside
    out. Vertices (V, 3) and faces (F, K), padded with -1, are as for `surface_normals`.
    """
    corners = np.asarray(faces, dtype=np.intp)
    turned = np.zeros(len(corners), dtype=bool)
    neighbours, agree = _neighbours(corners)
    volumes = _volumes(vertices, corners)
    if not agree.all():
        # Each face twice, as it is and turned over: neighbours that disagree are joined crosswise.
        first, second = neighbours.T
        cross = np.where(agree, 0, len(corners))
        pairs = np.concatenate(
            [[first, second + cross], [first + len(corners), second + len(corners) - cross]], axis=1
        ).T
        side = connected(2 * len(corners), pairs).reshape(2, -1)
        piece, turned = side.min(axis=0), side[0] > side[1]
        mixed = np.zeros(2 * len(corners), dtype=bool)
        mixed[piece[neighbours[~agree, 0]]] = True
        volume = np.bincount(piece, np.where(turned, -1.0, 1.0) * volumes, minlength=2 * len(corners))
        turned = (turned ^ (volume < 0.0)[piece]) & mixed[piece]
    whole = float((np.where(turned, -1.0, 1.0) * volumes).sum())
    return np.asarray(~turned if whole < 0.0 else turned)


def turned_over(corners: NDArray[_Number], faces: IntArray, chosen: NDArray[np.bool_]) -> NDArray[_Number]:
    """Return the corners (F, K, ...) of faces (F, K), of which the `chosen` (F,) are in the opposite order."""
    if not chosen.any():
        return corners
    place = np.arange(faces.shape[1])
    count = (np.asarray(faces)[chosen] >= 0).sum(axis=1, keepdims=True)
    order = np.where(place < count, -place % np.maximum(count, 1), place)
    out = corners.copy()
    out[chosen] = np.take_along_axis(corners[chosen], order.reshape(*order.shape, *[1] * (corners.ndim - 2)), axis=1)
    return out


def _neighbours(faces: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Pairs of faces (N, 2) that share an edge, which no other has, and whether they run along it oppositely, (N,)."""
    following: NDArray[np.intp] = np.roll(faces, -1, axis=1)
    following = np.where((faces >= 0) & (following < 0), faces[:, :1], following)
    used = (faces >= 0) & (faces != following)
    row = np.broadcast_to(np.arange(len(faces))[:, None], faces.shape)[used]
    start, end = faces[used], following[used]
    key = np.minimum(start, end) * (int(faces.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) > 0])) if len(order) else order
    pairs = first[np.diff(np.append(first, len(order))) == 2]
    one, other = order[pairs], order[pairs + 1]
    return np.stack([row[one], row[other]], axis=1), (start[one] < end[one]) != (start[other] < end[other])


def _volumes(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Signed volume between each face and the middle of the vertices, (F,); positive if it is seen from outside."""
    triangles = triangulate(faces)
    face = np.concatenate([np.flatnonzero(faces[:, k] >= 0) for k in range(2, faces.shape[1])])
    a, b, c = (np.asarray(vertices, dtype=np.float64)[triangles] - np.mean(vertices, axis=0)).transpose(1, 0, 2)
    return np.asarray(np.bincount(face, (a * np.cross(b, c)).sum(axis=1), minlength=len(faces)))
