"""Grey renderings of a mesh as the viewer sees it, and the way back from pixels to its surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..mesh.raster import rasterise
from ..mesh.surface import surface_normals, triangulate
from ..numeric.arrays import FloatArray, IntArray

SIZE = 256
"""Side of a portrait in pixels."""
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

        Parameters
        ----------
        centres : (2, 2) float64
            Middles of the eyes in pixels.
        reach : float
            Outer-eye distance in pixels.

        Returns
        -------
        Portrait
            The portrait with eyes.
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


class Sitter:
    """A mesh from which portraits are made.

    Parameters
    ----------
    places : (V, 3) float64
        Vertices; the viewer looks along z, and y is down.
    faces : (F, K) int
        Vertices of each face, padded with -1.
    """

    def __init__(self, places: FloatArray, faces: IntArray) -> None:
        self.places, self.triangles = places, triangulate(faces)
        outward = 1.0 if _volume(places, self.triangles) >= 0.0 else -1.0
        self._normals = outward * surface_normals(places, faces)

    def portrait(
        self, centre: FloatArray | None = None, reach: float = 0.0, turn: FloatArray | None = None
    ) -> Portrait:
        """Draw the mesh.

        Parameters
        ----------
        centre : (2,) array, optional
            Middle of the portrait, in x and y of the rotated mesh; by default the portrait shows the whole mesh.
        reach : float
            Distance from the middle to the sides, in the unit of the mesh.
        turn : (3, 3) array, optional
            Rotation of the mesh before it is drawn.

        Returns
        -------
        Portrait
            The portrait of the rotated mesh.
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
        # A normal along the line of sight (+z) shows the back of a surface: the inside of an open mouth, or an empty
        # socket.
        hollow = _enclosed(drawn.depth)
        hollow.ravel()[drawn.pixel] = facing[:, 2] > 0.1
        image = np.full(SIZE * SIZE, _BACKDROP)
        image[drawn.pixel] = lit
        image[hollow.ravel()] = _INSIDE
        grey = (_SKIN * image).astype(np.uint8).reshape(SIZE, SIZE)
        return Portrait(grey, corner, pixel, drawn.depth * np.float32(pixel) + np.float32(middle), hollow)


def _enclosed(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mark the pixels of the background that the mesh surrounds, (S, S): eyes and mouth of a face without a back."""
    _, label = cv2.connectedComponents((~np.isfinite(depth)).astype(np.uint8), connectivity=4)
    around = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    return ~np.isin(label, around) & ~np.isfinite(depth)


def _volume(places: FloatArray, triangles: IntArray) -> float:
    """Signed volume between the triangles and the middle of the mesh; positive if normals point outwards."""
    a, b, c = (places[triangles] - places.mean(axis=0)).transpose(1, 0, 2)
    return float(np.einsum("td,td->", a, np.cross(b, c)))
