"""Sparse symmetric systems on meshes, solved by scipy's SuperLU (method.md, section 5.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike

from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray


class SymmetricSystem:
    """Solve ``A x = b`` for a sparse positive definite A.

    Parameters
    ----------
    edges : (E, 2) array of int
        Pairs of different unknowns, each pair once.
    weights : (E,) array
        Entries of A at `edges`.
    diagonal : (N,) array
        Diagonal of A.
    dtype : data type
        Precision. Single precision takes half the time and memory and suffices for well-conditioned systems.
    """

    def __init__(
        self, edges: IntArray, weights: FloatArray, diagonal: FloatArray, dtype: DTypeLike = np.float64
    ) -> None:
        sparse, count = linalg.part("sparse"), len(diagonal)
        upper = sparse.coo_matrix((weights, tuple(np.asarray(edges).T)), (count, count))
        matrix = (upper + upper.T + sparse.diags(diagonal)).tocsc().astype(dtype)
        self._dtype = np.dtype(dtype)
        self._factor = linalg.part("sparse.linalg").splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for K right-hand sides (N, K), in the precision of the solver."""
        return np.asarray(self._factor.solve(np.asarray(right, dtype=self._dtype)))

    def sandwich(self, seeds: IntArray, masses: FloatArray) -> FloatArray:
        """Return the columns `seeds` (K,) of ``A^-1 M A^-1`` with a diagonal M, `masses`; zeros for seeds of -1."""
        columns = np.zeros((len(masses), len(seeds)))
        given = np.flatnonzero(seeds >= 0)
        columns[seeds[given], given] = 1.0
        return self.solve(masses[:, None] * self.solve(columns))
