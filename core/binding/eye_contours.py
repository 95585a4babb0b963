"""Landmarks of the lids where they are seen against the eye, on a character with separate eyes.

The border of such a mesh is not the rim of its lids, as the skin continues behind them into the socket. Seen from the
front, the rim is where the skin ends and the eye begins (method.md, section 7.1).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..mesh.raster import rasterise
from ..mesh.surface import triangulate
from ..numeric.arrays import FloatArray, IntArray

_SIDE = 240
"""Side of the rendering of an eye in pixels."""
_MARGIN = 1.25
"""Side of that rendering, in sizes of the eye."""
_SHARES = (0.36, 0.66)
"""Positions of the landmarks of a lid along the eye, from the outer corner, as on labelled faces."""
_MIN_WIDTH = 0.25
"""Smallest visible width of an eye, in sizes of the eye, for it to count as open."""
_MIN_OPEN = 0.05
"""Smallest visible height of an eye, in sizes of the eye, for it to count as open."""
_RING = 2
"""Distance in pixels beyond the rim of the eye within which its skin is sought."""


def lids_seen(
    skin: FloatArray, skin_faces: IntArray, eye: FloatArray, eye_faces: IntArray, *, left: bool
) -> NDArray[np.intp] | None:
    """Find the landmarks of an eye on the skin.

    Parameters
    ----------
    skin : (V, 3) array
        Vertices of the skin, upright and facing the viewer, in the head frame.
    skin_faces : (F, K) array of int
        Its faces, padded with -1.
    eye, eye_faces : (E, 3), (G, K) array
        Vertices and faces of the pieces of the eye.
    left : bool
        Whether it is the character's left eye.

    Returns
    -------
    (6,) intp or None
        Vertices of the skin in the order of `EYES`; None if the eye is shut or hidden.
    """
    look = _look(skin, skin_faces, eye, eye_faces)
    # Glints, tear ducts and parts of the eye that shine through the cheek are smaller than the visible eye.
    mask = _largest(look.owner >= look.skin)
    if mask is None or np.ptp(np.nonzero(mask)[1]) < _MIN_WIDTH * look.size:
        return None
    if mask.sum(axis=0).max() < _MIN_OPEN * look.size:
        return None
    wanted = _rim_points(mask, left=left)
    # The rim of the lids is the skin that borders on the visible eye, within a ring of pixels.
    ring = cv2.dilate(mask, np.ones((2 * _RING + 1, 2 * _RING + 1), np.uint8)).astype(bool) & ~mask.astype(bool)
    around = look.owner[ring]
    rim = np.unique(look.triangles[around[(around >= 0) & (around < look.skin)]])
    if len(rim) < len(wanted):
        return None
    return _distinct(rim, np.linalg.norm(look.pixels[rim][None] - wanted[:, None], axis=2))


def eye_openness(skin: FloatArray, skin_faces: IntArray, eye: FloatArray, eye_faces: IntArray) -> float:
    """Measure how much of an eye is seen from the front.

    Parameters
    ----------
    skin, skin_faces, eye, eye_faces : array
        As for `lids_seen`.

    Returns
    -------
    float
        Visible area as a share of the squared size of the eye.
    """
    look = _look(skin, skin_faces, eye, eye_faces)
    return float((look.owner >= look.skin).sum() / look.size**2)


class _Look(NamedTuple):
    """A rendering of an eye.

    Attributes
    ----------
    owner : (S, S) intp
        The triangle in each pixel, or -1.
    triangles : (T, 3) intp
        Triangles; the first `skin` are those of the skin.
    skin : int
        Number of triangles of the skin.
    pixels : (V, 2) float64
        Vertices in pixels.
    size : float
        Size of the eye in pixels.
    """

    owner: NDArray[np.intp]
    triangles: NDArray[np.intp]
    skin: int
    pixels: FloatArray
    size: float


def _look(skin: FloatArray, skin_faces: IntArray, eye: FloatArray, eye_faces: IntArray) -> _Look:
    low, high = eye.min(axis=0), eye.max(axis=0)
    size = float((high - low)[:2].max())
    scale = (_SIDE - 1) / (_MARGIN * size)
    places = np.concatenate([skin, eye])
    pixels = (places[:, :2] - (low[:2] + high[:2]) / 2.0 + _MARGIN * size / 2.0) * scale
    own = triangulate(skin_faces)
    triangles = np.concatenate([own, triangulate(eye_faces) + len(skin)])
    seen = rasterise(pixels, places[:, 2], triangles, _SIDE)
    owner = np.full(_SIDE * _SIDE, -1, dtype=np.intp)
    owner[seen.pixel] = seen.triangle
    return _Look(owner.reshape(_SIDE, _SIDE), triangles, len(own), pixels, size * scale)


def _largest(mask: NDArray[np.bool_]) -> NDArray[np.uint8] | None:
    """Return the largest connected part of a mask, or None if it is empty."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if count < 2:
        return None
    best = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return np.asarray(labels == best, dtype=np.uint8)


def _rim_points(mask: NDArray[np.uint8], *, left: bool) -> FloatArray:
    """Corners and lids in pixels, (6, 2), in the order of `EYES`."""
    columns = np.flatnonzero(mask.any(axis=0))
    upper, lower = mask.argmax(axis=0), mask.shape[0] - 1 - mask[::-1].argmax(axis=0)
    first, last = columns[0], columns[-1]

    def middle(column: int) -> tuple[float, float]:
        return float(column), float(upper[column] + lower[column]) / 2.0

    outer, inner = (last, first) if left else (first, last)
    along = [round(outer + share * (inner - outer)) for share in _SHARES]
    above = [(float(x), float(upper[x]) - 0.5) for x in along]
    below = [(float(x), float(lower[x]) + 0.5) for x in along]
    points = [middle(outer), above[0], above[1], middle(inner), below[1], below[0]]
    return np.array(points)


def _distinct(rim: IntArray, away: FloatArray) -> NDArray[np.intp]:
    """Choose for each landmark the nearest vertex of `rim` by `away` (6, R) that is still free, (6,); corners first."""
    chosen = np.zeros(len(away), dtype=np.intp)
    free = away.copy()
    for row in (0, 3, 1, 2, 4, 5):
        chosen[row] = int(np.argmin(free[row]))
        free[:, chosen[row]] = np.inf
    return np.asarray(rim[chosen], dtype=np.intp)
