"""Smooth warps between faces: from the landmarks of one to those of another, for every place between."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, as_points
from ..errors import HeadError
from .kernels import distances

_CHUNK = 4_000


class Warp:
    """The smoothest map of space that takes (P, 3) `source` points to `target` ones.

    Parameters
    ----------
    smoothing : float
        How far a point may stay away, for the sake of smoothness; 0 meets all.

    Notes
    -----
    A biharmonic spline in three dimensions: kernel -r beside an affine map (Duchon 1977; Bookstein 1989). Solvable
    where the points do not lie in one plane.
    """

    def __init__(self, source: FloatArray, target: FloatArray, smoothing: float = 1e-3) -> None:
        self._source = as_points(source, "source", error=HeadError)
        goal = as_points(target, "target", count=len(self._source), error=HeadError)
        count = len(self._source)
        extent = float(np.linalg.norm(np.ptp(self._source, axis=0)))
        affine = np.column_stack([np.ones(count), self._source])
        system = np.zeros((count + 4, count + 4))
        system[:count, :count] = smoothing * extent * np.eye(count) - distances(self._source, self._source)
        system[:count, count:], system[count:, :count] = affine, affine.T
        try:
            self._weights = np.linalg.solve(system, np.concatenate([goal, np.zeros((4, 3))]))
        except np.linalg.LinAlgError as error:
            raise HeadError("The landmarks lie in one plane. Bind them to the vertices that they name.") from error

    def __call__(self, points: FloatArray) -> FloatArray:
        """Where (N, 3) `points` come to lie."""
        count = len(self._source)
        out = np.empty((len(points), 3))
        for start in range(0, len(points), _CHUNK):
            part = np.asarray(points[start : start + _CHUNK], dtype=np.float64)
            affine = np.column_stack([np.ones(len(part)), part])
            out[start : start + _CHUNK] = affine @ self._weights[count:]
            out[start : start + _CHUNK] -= distances(part, self._source) @ self._weights[:count]
        return out
