"""Grey renderings of a mesh as the viewer sees it, the way back from pixels to its surface, and lids that are seen
against the eye.

The border of such a mesh is not the rim of its lids, as the skin continues behind them into the socket. Seen from
the front, the rim is where the skin ends and the eye begins (method.md, section 7.1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..mesh.surface import surface_normals, triangulate
from ..mesh.triangles import Fragments, rasterise
from ..mesh.winding import turned_over
from ..numeric.arrays import FloatArray, IntArray
from .rig import Skin

SIZE = 256
"""Side of a portrait in pixels."""
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


_LIGHT = np.array([0.0, -0.67, -0.74])
"""Direction to the light, from above; of six lights the one under which lids and nose were found best."""
_AMBIENT = 0.35
"""Brightness of skin in shadow, relative to skin in full light."""
_INSIDE = 0.12
"""Brightness of surfaces seen from inside, such as an open mouth, relative to skin in full light."""
_BACKDROP = 0.55
"""Brightness of the background, relative to skin in full light."""
_SKIN = 200.0
"""Grey value of skin in full light."""
_DIFFUSE = 0.6
"""Share of light from everywhere on a mesh in its own colours, whose texture already has some shading."""
_COMPLEXION = 0.65
"""Median brightness of a mesh in its own colours, so that dark skin is as well lit as fair skin."""
_DARKEST = 0.02
"""Median above which it is scaled to that."""
_WHITE = 0.85
"""Brightness of an eye that is drawn into an empty socket, relative to skin in full light."""
_DARK = 0.2
"""Brightness of its iris, relative to skin in full light."""
_IRIS = 0.065
"""Radius of that iris, in outer-eye distances."""
_SOCKET = 0.25
"""Distance from the middle of an eye, in outer-eye distances, within which its socket lies; a socket is at most twice
as wide."""
_RIM = 5
"""Side in pixels of the neighbourhood whose nearest surface counts, so that a lid is not missed for the socket."""
_STEP = 8.0
"""Difference of depth in pixels above which the nearest surface of a neighbourhood is a rim."""

_MIN_PIXEL = 1e-30
"""Smallest size of a pixel, for a mesh that is a single point."""


@dataclass(frozen=True)
class Portrait:
    """A rendering of a mesh without perspective.

    Attributes
    ----------
    image : (S, S) uint8
        Grey image.
    corner : (2,) float64
        Position of the first pixel, in x and y of the mesh.
    pixel : float
        Size of a pixel, in the unit of the mesh.
    depth : (S, S) float32
        z of the surface in each pixel; infinite where there is none.
    hollow : (S, S) bool
        Whether the mesh is seen from inside, or surrounds the background.
    """

    image: NDArray[np.uint8]
    corner: FloatArray
    pixel: float
    depth: NDArray[np.float32]
    hollow: NDArray[np.bool_]

    def with_eyes(self, centres: FloatArray, reach: float) -> Portrait:
        """Draw an eye into each empty socket, because the tracker takes sockets for shut lids.

        The middles of the eyes (2, 2) and `reach`, the outer-eye distance, are in pixels.
        """
        image = self.image.copy()
        _, label = cv2.connectedComponents(self.hollow.astype(np.uint8), connectivity=4)
        y, x = np.nonzero(self.hollow)
        for centre in centres:
            away = np.hypot(x - centre[0], y - centre[1])
            if not len(away) or away.min() > _SOCKET * reach:
                continue
            nearest = away.argmin()
            socket = label == label[y[nearest], x[nearest]]
            rows, columns = np.nonzero(socket)
            if np.ptp(columns) > 2.0 * _SOCKET * reach:
                continue
            middle = (rows.min() + rows.max()) / 2.0, (columns.min() + columns.max()) / 2.0
            iris = np.hypot(rows - middle[0], columns - middle[1]) < _IRIS * reach
            image[rows, columns] = _SKIN * np.where(iris, _DARK, _WHITE)
        return replace(self, image=image)

    def places(self, points: FloatArray) -> FloatArray:
        """Return the places on the mesh, (N, 3), that are seen at (N, 2) pixels; their depth is NaN beside the mesh."""
        # Erosion takes the least depth, so the nearest surface, of each neighbourhood.
        nearest = cv2.erode(self.depth, np.ones((_RIM, _RIM), np.uint8))
        x, y = np.clip(np.round(points), 0, SIZE - 1).astype(np.intp).T
        own, rim = self.depth[y, x], nearest[y, x]
        depth = np.where(own < rim + _STEP * self.pixel, own, rim)
        depth[~np.isfinite(depth)] = np.nan
        return np.column_stack([self.corner + self.pixel * points, depth])


@dataclass(frozen=True, eq=False)
class Paint:
    """The colours of a mesh, in grey.

    Attributes
    ----------
    image : (H, W) uint8
        The image, or several beside each other.
    uv : (F, K, 2) float32
        Pixels `(x, y)` of the image that the corners of each face show.
    """

    image: NDArray[np.uint8]
    uv: NDArray[np.float32]

    def of_faces(self, rows: IntArray) -> Paint:
        """Return the paint of some faces only."""
        return Paint(self.image, self.uv[rows])

    def of_skin(self, skin: Skin) -> Paint:
        """Return the paint of the faces of a skin."""
        return Paint(self.image, turned_over(self.uv[skin.rows], skin.faces, skin.turned))


class Sitter:
    """A mesh from which portraits are made: as if of clay, or in its own colours if it has a `paint`.

    Parameters
    ----------
    places : (V, 3) float64
        Vertices; the viewer looks along z, and y is down.
    faces : (F, K) int
        Vertices of each face, padded with -1.
    """

    def __init__(self, places: FloatArray, faces: IntArray, paint: Paint | None = None) -> None:
        self.places, self.triangles = places, triangulate(faces)
        self._paint = None if paint is None else Paint(paint.image, _of_triangles(paint.uv, faces))
        outward = 1.0 if _volume(places, self.triangles) >= 0.0 else -1.0
        self._normals = outward * surface_normals(places, faces)

    def portrait(
        self, centre: FloatArray | None = None, reach: float = 0.0, turn: FloatArray | None = None
    ) -> Portrait:
        """Draw the mesh, which may be rotated by `turn` (3, 3) before.

        `centre` (2,) is the middle of the portrait, in x and y of the rotated mesh, and `reach` the distance from there
        to the sides, in the unit of the mesh; by default the portrait shows the whole mesh.
        """
        places, normals = (values if turn is None else values @ turn.T for values in (self.places, self._normals))
        if centre is None:
            low, high = places.min(axis=0)[:2], places.max(axis=0)[:2]
            centre, reach = (low + high) / 2.0, 0.65 * float((high - low).max())
        pixel = max(2.0 * reach / SIZE, _MIN_PIXEL)
        corner = centre - pixel * (SIZE - 1) / 2.0
        middle = float(places[:, 2].mean())
        points, depth = (places[:, :2] - corner) / pixel, (places[:, 2] - middle) / pixel
        # Lambert's law with normals interpolated over each triangle (Phong 1975), so that coarse meshes look smooth.
        drawn = rasterise(points, depth, self.triangles, SIZE)
        facing = (drawn.barycentric[:, :, None] * normals[self.triangles[drawn.triangle]]).sum(axis=1)
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
        lit = _AMBIENT + (1.0 - _AMBIENT) * np.maximum(facing @ _LIGHT, 0.0)
        if self._paint is not None:
            shown = _colours(self._paint, drawn)
            lit = _DIFFUSE + (1.0 - _DIFFUSE) * lit
            lit *= shown * (_COMPLEXION / max(float(np.median(lit * shown)), _DARKEST))
        # A normal along the line of sight (+z) shows the back of a surface: the inside of an open mouth, or an empty
        # socket.
        hollow = _enclosed(drawn.depth)
        hollow.ravel()[drawn.pixel] = facing[:, 2] > 0.1
        image = np.full(SIZE * SIZE, _BACKDROP)
        image[drawn.pixel] = lit
        image[hollow.ravel()] = _INSIDE
        grey = np.minimum(_SKIN * image, 255.0).astype(np.uint8).reshape(SIZE, SIZE)
        return Portrait(grey, corner, pixel, drawn.depth * np.float32(pixel) + np.float32(middle), hollow)


def _of_triangles(uv: NDArray[np.float32], faces: IntArray) -> NDArray[np.float32]:
    """Return (T, 3, 2) coordinates of the corners of `triangulate(faces)` from those of faces, (F, K, 2)."""
    whole = np.asarray(faces)
    fans = [uv[whole[:, k] >= 0][:, [0, k - 1, k]] for k in range(2, whole.shape[1])]
    return np.concatenate(fans) if fans else np.empty((0, 3, 2), np.float32)


def _colours(paint: Paint, drawn: Fragments) -> NDArray[np.float32]:
    """Brightness of the paint in each covered pixel, 0 to 1."""
    where = np.zeros((SIZE * SIZE, 2), np.float32)
    where[drawn.pixel] = (drawn.barycentric[:, :, None] * paint.uv[drawn.triangle]).sum(axis=1)
    # Sampled as an image, as the length of a row is limited.
    x, y = (np.ascontiguousarray(axis) for axis in where.reshape(SIZE, SIZE, 2).transpose(2, 0, 1))
    shown = np.asarray(cv2.remap(paint.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    return np.asarray(shown.ravel()[drawn.pixel] / np.float32(255.0))


def _enclosed(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mark the pixels of the background that the mesh surrounds, (S, S): eyes and mouth of a face without a back."""
    _, label = cv2.connectedComponents((~np.isfinite(depth)).astype(np.uint8), connectivity=4)
    around = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    return ~np.isin(label, around) & ~np.isfinite(depth)


def _volume(places: FloatArray, triangles: IntArray) -> float:
    """Signed volume between the triangles and the middle of the mesh; positive if normals point outwards."""
    a, b, c = (places[triangles] - places.mean(axis=0)).transpose(1, 0, 2)
    return float(np.einsum("td,td->", a, np.cross(b, c)))


def lids_seen(
    skin: FloatArray, skin_faces: IntArray, eye: FloatArray, eye_faces: IntArray, *, left: bool
) -> NDArray[np.intp] | None:
    """Find the six landmarks of an eye on the skin, in the order of `EYES`; None if the eye is shut or hidden.

    The vertices (V, 3) of the skin and (E, 3) of the pieces of the eye are upright and facing the viewer, in the head
    frame. `left` is the character's own left.
    """
    look = _look(skin, skin_faces, eye, eye_faces)
    # Where else an eyeball is seen, as through a gap of the mesh, is smaller than the eye between its lids.
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
    """Measure the area of an eye that is seen from the front, as a share of the squared size of the eye."""
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
