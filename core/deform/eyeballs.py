"""Lids slide over the eyeballs rather than through them.

A lid that closes along a straight line cuts the corner of the sphere that it should roll over: the eye shows through
the skin. Vertices near an eyeball are therefore kept at least as far from its centre as its surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

_REACH = 1.8


class EyeballContact:
    """Keeps the skin outside the eyeballs.

    Parameters
    ----------
    rest : (V, 3) array
        Vertices at rest.
    weights : (V,) array
        Vertices of weight 0 do not move and are left alone.
    eyeballs : (E, 4) array
        Centre and radius of each eyeball, frame and unit of `rest`.

    Notes
    -----
    A vertex that lies within the eyeball at rest (the lid's inner rim) may stay as near as it was.
    """

    def __init__(self, rest: FloatArray, weights: FloatArray, eyeballs: FloatArray) -> None:
        self._contacts: list[tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]] = []
        for x, y, z, radius in np.asarray(eyeballs, dtype=np.float64).reshape(-1, 4):
            centre = np.array([x, y, z])
            distance = np.linalg.norm(rest - centre, axis=1)
            rows = np.flatnonzero((weights > 0) & (distance < _REACH * radius))
            nearest = np.minimum(distance[rows], radius)
            self._contacts.append((rows, centre.astype(np.float32), nearest.astype(np.float32)))

    def resolve(self, vertices: NDArray[np.float32]) -> None:
        """Push what lies too deep out along the radius, in place; (V, 3) float32."""
        for rows, centre, nearest in self._contacts:
            outward = vertices[rows] - centre
            distance = np.sqrt(np.einsum("ij,ij->i", outward, outward))
            deep = (distance < nearest) & (distance > 0)
            stretch = nearest[deep] / distance[deep]
            vertices[rows[deep]] = centre + outward[deep] * stretch[:, None]
