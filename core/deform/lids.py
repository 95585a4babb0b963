"""Eyes that are one skin with their lids, as a scan's are: where to cut so that the lids can shut over them.

A cut along the mesh's own edges would leave a rim of teeth that cannot meet, so edges are split where an almond through
the lids crosses them. What lies within becomes an eye on a sphere that touches the lids from behind, and the lids slide
over that (`EyeballContact`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..errors import HeadError
from ..landmarks import from_ibug
from .surface import JOINED, SurfaceGraph

EYES = from_ibug((36, 37, 38, 39, 40, 41)), from_ibug((45, 44, 43, 42, 47, 46))
"""Right and left eye: outer corner, upper lid, inner corner, lower lid; each other's mirror image."""
_UPPER, _LOWER = slice(1, 3), slice(4, 6)
_USUAL = np.array([[0.76, 0.0], [-0.48, 0.0]])
"""Curves of the upper and of the lower lid, as in `EyeOutline`: about those of labelled scans."""
_TRUST = 0.03
"""How much the usual curve counts beside two landmarks: about a quarter."""
_WITHIN = 0.1
"""Of the eye's width from its corners: nearer to them a way from lid to lid may lead round an open eye."""
_REACH = 1.0
_FINE = 0.1
"""Longest edge about an eye that is not too coarse, and how far from it the lids still stretch, in its widths."""
_STRETCH = 0.35
_SNAP = 0.15
"""Of an edge: a vertex as near to the cut as that is taken to lie on it, which saves slivers."""
_ROUND = 0.7
"""Radius of the sphere on which lids lie, in widths of the eye; so it is, within a fiftieth, on labelled faces."""
_BESIDE = 0.15
"""How far about the cut the sphere is kept behind the skin, and how far the eye goes on behind the lids, in widths."""
_PITS = 95.0
"""Percentile of the skin that lies before the sphere: what noise dents deeper does not push the eye in."""
_STEEP = 0.95
_LEAST_RIM = 8


@dataclass(frozen=True)
class EyeOutline:
    """An almond between the corners of an eye, in the plane of its width and of the head's height.

    Attributes
    ----------
    corner : (3,) float
        The outer corner.
    axes : (3, 3) float
        Rows: unit vectors towards the inner corner, up, and towards the viewer.
    width : float
        From corner to corner.
    lids : (2, 2) float
        `(a, b)` of the upper and of the lower lid: its height over the line from corner to corner, in widths, is
        s (1 - s) (a + b (2 s - 1)) at the share s of the way to the inner corner.
    """

    corner: FloatArray
    axes: FloatArray
    width: float
    lids: FloatArray

    def local(self, points: FloatArray) -> FloatArray:
        """(..., 3) in widths from the outer corner: along to the inner one, up, and towards the viewer."""
        return np.asarray((points - self.corner) @ self.axes.T / self.width)

    def places(self, local: FloatArray) -> FloatArray:
        """(..., 3) in the frame of the mesh: the inverse of `local`."""
        return np.asarray(self.corner + self.width * local @ self.axes)

    def depth_within(self, local: FloatArray) -> FloatArray:
        """(...) how far a point lies within the almond, by height, in widths; below 0 outside."""
        along, up = local[..., 0], local[..., 1]
        upper, lower = (along * (1.0 - along) * (a + b * (2.0 * along - 1.0)) for a, b in self.lids)
        return np.asarray(np.minimum(upper - up, up - lower))


@dataclass(frozen=True)
class EyeCut:
    """How one eye is cut out of a mesh of V vertices.

    Attributes
    ----------
    edges : (K, 2) intp
        Edges to be split, the vertex within the eye first. The new vertices are V, V + 1 and so on.
    shares : (K,) float
        How far from the vertex within.
    chords : (C, 2) intp
        Pairs of vertices, of the new ones among others, to be joined by an edge across the face that has both.
    rim : (N,) intp
        The closed cut, from the outer corner along the upper lid to the inner corner and back.
    inner : int
        Place of the inner corner in `rim`.
    within : (M,) intp
        Vertices of the eye that are not on the rim.
    outline : EyeOutline
    eyeball : (4,) float
        Centre and radius of the sphere that touches the lids from behind, frame of the mesh.
    """

    edges: NDArray[np.intp]
    shares: FloatArray
    chords: NDArray[np.intp]
    rim: NDArray[np.intp]
    inner: int
    within: NDArray[np.intp]
    outline: EyeOutline
    eyeball: FloatArray
