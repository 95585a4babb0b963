"""Lids that meet along their whole rims, not only at their landmarks (method.md, section 5.6).

A lid has two landmarks between the corners of the eye. Even if they meet those of the other lid, the rims between them
may not: on a stylised eye, whose outer third is long and steep, a wide gap remains. Its width follows from the mesh at
rest, so the matrix of the deformer is corrected once, and a frame costs no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import outer_eye_distance
from ..heads.rims import EYES, Rim, Slit, rims_of
from ..mesh.surface import NearestPoints
from ..numeric.arrays import FloatArray, IntArray
from .blocks import RegionMatrix

_REACH = 0.12
"""Distance from the rim, in outer-eye distances, within which the lid follows it."""
_NEIGHBOURS = 8
_BLUR = 0.01
"""Number of vertices of the rim that the skin beside it follows, and the distance, in outer-eye distances, below which
they count alike."""
_MOST = 0.5
"""Largest correction relative to the opening of the eye, in case a rim is not where its landmarks say."""

Response = Callable[[NDArray[np.intp]], FloatArray]
"""Returns rows of the matrix of a deformer, (N, 66), for vertices (N,)."""


@dataclass(frozen=True)
class LidRims:
    """The rims of an eye, and the skin of its upper lid.

    Attributes
    ----------
    slit : Slit
        Landmarks of the eye.
    places : (V, 3) float64
        Vertices at rest.
    points : (66, 3) float64
        Landmarks at rest.
    upper, lower : Rim
        The rims, with positions 0 at the first corner, 1 and 2 at the landmarks, and 3 at the second corner.
    rows : (R,) intp
        Vertices that are corrected.
    nearest : (R, K) intp
        Indices into the upper rim that each of them follows.
    spread : (R, K) float64
        Their weights.
    """

    slit: Slit
    places: FloatArray
    points: FloatArray
    upper: Rim
    lower: Rim
    rows: NDArray[np.intp]
    nearest: NDArray[np.intp]
    spread: FloatArray

    def correction(self, response: Response) -> RegionMatrix:
        """Compute the matrix to add to that of a deformer so that the rims meet when the landmarks do.

        `response` returns rows (N, 66) of the deformer's matrix for vertices (N,). Let the landmarks of the upper lid
        move onto those of the lower one, by g_1 and g_2. A vertex of the upper rim then lacks r along them to reach the
        place of the lower rim that corresponds to it. It moves by (equation 5.8) ``sum_j r w_j / |g_j| (d_j - e_j)`` in
        addition, where d_j and e_j are the displacements of the landmarks of the upper and the lower lid, and w_j is
        the weight of the pair at its position along the rim.
        """
        upper, lower = self.slit.upper[1:3], self.slit.lower[1:3]
        gaps = self.points[lower] - self.points[upper]
        sizes = np.linalg.norm(gaps, axis=1)
        down = gaps.sum(axis=0) / np.linalg.norm(gaps.sum(axis=0))

        def closed(vertices: NDArray[np.intp]) -> FloatArray:
            return np.asarray(self.places[vertices] + response(vertices)[:, upper] @ gaps)

        # Where both rims come to lie when the landmarks of the upper lid meet those of the lower; the lower rim is
        # sampled at the positions of the upper one.
        rim = closed(self.lower.vertices)
        wanted = np.stack([np.interp(self.upper.at, self.lower.at, rim[:, i]) for i in range(3)], axis=1)
        most = _MOST * float(sizes.mean())
        lacking = np.clip((wanted - closed(self.upper.vertices)) @ down, -most, most)
        # w_1 and w_2 of equation 5.8: linear between the landmarks at 1 and 2, constant towards the corners.
        second = np.clip(self.upper.at - 1.0, 0.0, 1.0)
        share = lacking[:, None] * np.stack([1.0 - second, second], axis=1) / sizes
        moved = (self.spread[:, None] @ share[self.nearest])[:, 0].astype(np.float32)
        return RegionMatrix(self.rows, np.concatenate([upper, lower]), np.concatenate([moved, -moved], axis=1))

    def gaps(self, posed: FloatArray) -> FloatArray:
        """Return how far below each vertex of the upper rim the lower one is, (N,), if vertices are at `posed` (V, 3).

        Negative where the lids overlap.
        """
        along, down = self._axes()
        (upper, height), (lower, depth) = (
            (posed[rim.vertices] @ along, posed[rim.vertices] @ down) for rim in (self.upper, self.lower)
        )
        order = np.argsort(lower, kind="stable")
        return np.asarray(np.interp(upper, lower[order], depth[order]) - height)

    def lowered(self, by: FloatArray) -> FloatArray:
        """Return the displacements (R, 3) of `rows` that lower each vertex of the upper rim by a distance, (N,)."""
        return np.asarray((self.spread[:, None] @ by[self.nearest][:, :, None])[:, 0] * self._axes()[1])

    def open_share(self, posed: FloatArray) -> float:
        """Return the area between the rims, relative to that at rest; nothing is open where lids overlap."""
        rest = self._area(self.places)
        return self._area(posed) / rest if rest > 0.0 else 0.0

    def _area(self, posed: FloatArray) -> float:
        along = posed[self.upper.vertices] @ self._axes()[0]
        order = np.argsort(along, kind="stable")
        gaps = np.maximum(self.gaps(posed), 0.0)[order]
        return float(0.5 * (gaps[1:] + gaps[:-1]) @ np.diff(along[order]))

    def _axes(self) -> tuple[FloatArray, FloatArray]:
        """Directions from the first corner to the second, and down across the eye, at rest, both (3,)."""
        first, *_, last = self.points[self.slit.upper]
        along = (last - first) / np.linalg.norm(last - first)
        down = (self.points[self.slit.lower] - self.points[self.slit.upper])[1:-1].sum(axis=0)
        down -= (down @ along) * along
        return along, down / np.linalg.norm(down)


def lid_rims(vertices: FloatArray, faces: IntArray, landmarks: IntArray, region_weights: FloatArray) -> list[LidRims]:
    """Find the rims of both eyes, except those that are modelled shut or joined to their lids.

    Arrays are as in `HeadRig`, in any frame.
    """
    places = np.asarray(vertices, dtype=np.float64)
    points = places[landmarks]
    unit = outer_eye_distance(points)
    # Only skin of the upper region moves with the upper lid.
    shares = np.asarray(region_weights, dtype=np.float64)
    above = shares[0] / np.maximum(shares.sum(axis=0), 1e-9)
    found = []
    for slit in EYES:
        if (rims := rims_of(places, np.asarray(faces), landmarks, slit)) is None:
            continue
        upper, lower = rims
        # The lid follows its rim, which is met exactly, and fades into the brow and the other lid.
        rim, reach = places[upper.vertices], _REACH * unit
        near = np.flatnonzero(((places > rim.min(axis=0) - reach) & (places < rim.max(axis=0) + reach)).all(axis=1))
        nearest, squared = NearestPoints(rim).query(places[near], min(_NEIGHBOURS, len(rim)))
        share = above[near] * np.square(np.maximum(1.0 - squared[:, 0] / reach**2, 0.0))
        on_rim = np.searchsorted(near, upper.vertices)
        share[on_rim] = 1.0
        lid = np.flatnonzero(share)
        spread = 1.0 / np.square(squared[lid] + (_BLUR * unit) ** 2)
        spread *= (share[lid] / spread.sum(axis=1))[:, None]
        spread[np.searchsorted(lid, on_rim)], nearest[on_rim, 0] = np.eye(1, spread.shape[1]), np.arange(len(rim))
        found.append(LidRims(slit, places, points, upper, lower, near[lid], nearest[lid], spread))
    return found
