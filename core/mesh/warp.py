"""Smooth warps of space that map given points to others (method.md, section 7.1)."""

from __future__ import annotations

import numpy as np

from ..errors import HeadError
from ..numeric import linalg
from ..numeric.arrays import FloatArray, as_points
from .kernels import distances

_CHUNK = 4_000


class Warp:
    """The smoothest map of space that takes the `source` points to the `target` points.

    Parameters
    ----------
    source, target : (P, 3) array
        Corresponding points.
    smoothing : float or (P,) array
        Added to the diagonal, as a share of the extent of the source, so that points may be missed; 0 meets all.

    Raises
    ------
    HeadError
        If the source points lie in one plane.

    Notes
    -----
    A biharmonic spline in three dimensions (equation 7.1): kernel -r and an affine map (Duchon 1977; Bookstein 1989).
    """

    def __init__(self, source: FloatArray, target: FloatArray, smoothing: float | FloatArray = 1e-3) -> None:
        self._source = as_points(source, "source", error=HeadError)
        goal = as_points(target, "target", count=len(self._source), error=HeadError)
        count = len(self._source)
        extent = float(np.linalg.norm(np.ptp(self._source, axis=0)))
        affine = np.column_stack([np.ones(count), self._source])
        # Interpolation conditions, and below them the side conditions that make the weights orthogonal to affine maps.
        system = np.zeros((count + 4, count + 4))
        system[:count, :count] = -distances(self._source, self._source)
        system[np.arange(count), np.arange(count)] += smoothing * extent
        system[:count, count:], system[count:, :count] = affine, affine.T
        try:
            self._weights = linalg.solve(system, np.concatenate([goal, np.zeros((4, 3))]))
        except np.linalg.LinAlgError as error:
            raise HeadError("The landmarks lie in one plane. Bind them again.") from error

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return the warped `points`, (N, 3)."""
        count = len(self._source)
        out = np.empty((len(points), 3))
        for start in range(0, len(points), _CHUNK):
            part = np.asarray(points[start : start + _CHUNK], dtype=np.float64)
            affine = np.column_stack([np.ones(len(part)), part])
            out[start : start + _CHUNK] = affine @ self._weights[count:]
            out[start : start + _CHUNK] -= distances(part, self._source) @ self._weights[:count]
        return out
