"""scipy's linear algebra, in one thread: `linalg.eigh`, for example, is `scipy.linalg.eigh`.

numpy calls LAPACK and multiplies large matrices fast only if it is built with a BLAS. Blender's own numpy is built
without one: it takes up to fifty times as long, and before numpy 2.2 two threads that use its substitute for LAPACK at
once get wrong results or end the process (numpy, issue 22509). scipy brings both, safe in threads.
"""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .arrays import FloatArray, IntArray


@cache
def _scipy() -> Any:
    """Load scipy, which takes a third of a second, when it is first needed rather than when the extension is enabled.

    Its BLAS gets a single thread. A BLAS shares products of ten thousand numbers among its threads, which on a busy
    machine wait for each other for a millisecond. The number belongs to the whole process, so that limits set around
    calls would end those of other threads; but this BLAS is scipy's alone, and numpy's keeps its threads.
    """
    import scipy.linalg  # type: ignore[import-untyped]
    from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

    own = _full_path(os.path.dirname(scipy.__file__))  # the name of the folder of its libraries begins like this, too
    for library in ThreadpoolController().lib_controllers:
        if _full_path(library.filepath).startswith(own):
            library.set_num_threads(1)
    return scipy.linalg


@cache
def part(name: str) -> Any:
    """Load another part of scipy, such as its sparse matrices, in the same way."""
    _scipy()
    return import_module(f"scipy.{name}")


def _full_path(path: str) -> str:
    return os.path.normcase(os.path.realpath(path))


def __getattr__(name: str) -> Any:
    if name.startswith("_"):
        raise AttributeError(name)
    function = globals()[name] = getattr(_scipy(), name)
    return function


def multiply(left: FloatArray, right: FloatArray) -> NDArray[Any]:
    """Multiply matrices, or a matrix and a vector, in single precision if either is, otherwise in double.

    scipy keeps Python's lock during a product, unlike numpy and OpenCV. What is computed in a thread while Blender's
    window is in use should consist of products that take milliseconds.
    """
    single = "f" in (left.dtype.char, right.dtype.char)
    if not left.size or not right.size:
        return np.zeros(left.shape[:-1] + right.shape[1:], np.float32 if single else np.float64)
    blas = _scipy().blas
    # A BLAS stores columns, so to it rows are the transpose: (A B)^T = B^T A^T.
    if right.ndim == 1:
        matrix, turned = _by_columns(left)
        return np.asarray((blas.sgemv if single else blas.dgemv)(1.0, matrix, right, trans=not turned))
    matrix, turned = _by_columns(right)
    if left.ndim == 1:
        return np.asarray((blas.sgemv if single else blas.dgemv)(1.0, matrix, left, trans=turned))
    other, other_turned = _by_columns(left)
    product = (blas.sgemm if single else blas.dgemm)(1.0, matrix, other, trans_a=turned, trans_b=other_turned)
    return np.asarray(product.T)


def _by_columns(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Return the transpose of a matrix as columns without a copy, or the matrix itself and True if it has columns."""
    return (matrix.T, False) if matrix.flags.c_contiguous else (matrix, True)


def squared_lengths(vectors: NDArray[Any]) -> NDArray[Any]:
    """Return the squared lengths (...) of vectors (..., 3), in a third of the time that `einsum` takes."""
    squares = np.square(vectors)
    return np.asarray(squares[..., 0] + squares[..., 1] + squares[..., 2])


def solve_definite(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a small symmetric positive definite system, in a fifth of the time that `solve` takes.

    A matrix that is not definite because of rounding takes longer. Raises LinAlgError if the matrix is singular.
    """
    lapack = _scipy().lapack
    _, solution, fault = lapack.dposv(matrix.T, right)
    if fault:
        *_, solution, fault = lapack.dgesv(matrix, right)
    if fault:
        raise np.linalg.LinAlgError("The matrix is singular.")
    return cast(FloatArray, solution)


def inverse_definite(matrix: FloatArray) -> FloatArray:
    """Invert a symmetric matrix; raises LinAlgError unless it is positive definite."""
    lapack = _scipy().lapack
    factor, fault = lapack.dpotrf(matrix.T)
    half, also = lapack.dpotri(factor)
    if fault or also:
        raise np.linalg.LinAlgError("The matrix is not definite.")
    return cast(FloatArray, half + np.triu(half, 1).T)


def inverses_of_three(matrices: NDArray[Any]) -> NDArray[Any]:
    """Invert a stack of matrices (..., 3, 3) by their cofactors; scipy takes one matrix at a time."""
    a, b, c = np.moveaxis(matrices, -2, 0)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    return np.asarray(cofactors / (a * cofactors[..., 0]).sum(axis=-1)[..., None, None])


class SymmetricSystem:
    """Solve ``A x = b`` for a sparse positive definite A by SuperLU (method.md, section 5.4).

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
        sparse, count = part("sparse"), len(diagonal)
        upper = sparse.coo_matrix((weights, tuple(np.asarray(edges).T)), (count, count))
        matrix = (upper + upper.T + sparse.diags(diagonal)).tocsc().astype(dtype)
        self._dtype = np.dtype(dtype)
        self._factor = part("sparse.linalg").splu(
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
