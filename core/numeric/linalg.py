"""numpy's linear algebra, one call at a time.

Blender's own numpy is built without LAPACK. numpy's substitute for it has global variables, so that before numpy 2.2
two threads that use it at once get wrong results or end the process (numpy, issue 22509). These functions wait for each
other instead; otherwise they are those of `numpy.linalg`. OpenCV solves the small systems of each frame without a wait.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import Lock
from typing import Any, TypeVar, cast

import cv2
import numpy as np

from .arrays import FloatArray

_Function = TypeVar("_Function", bound=Callable[..., Any])
_LOCK = Lock()


def _alone(function: _Function) -> _Function:
    """Return `function`, made to wait until no other of these functions is running."""

    @wraps(function)
    def alone(*arguments: Any, **options: Any) -> Any:
        with _LOCK:
            return function(*arguments, **options)

    return cast("_Function", alone)


cond = _alone(np.linalg.cond)
det = _alone(np.linalg.det)
eigh = _alone(np.linalg.eigh)
eigvalsh = _alone(np.linalg.eigvalsh)
inv = _alone(np.linalg.inv)
lstsq = _alone(np.linalg.lstsq)
matrix_rank = _alone(np.linalg.matrix_rank)
norm = _alone(np.linalg.norm)
qr = _alone(np.linalg.qr)
solve = _alone(np.linalg.solve)
svd = _alone(np.linalg.svd)


def solve_definite(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a small symmetric positive definite system, by OpenCV, and so beside other threads.

    Parameters
    ----------
    matrix : (K, K) float64
        The matrix.
    right : (K,) float64
        The right-hand side.

    Returns
    -------
    (K,) float64
        The solution.

    Raises
    ------
    LinAlgError
        If the matrix is singular.

    Notes
    -----
    A matrix that is not definite because of rounding takes longer.
    """
    solved, solution = cv2.solve(matrix, right, flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(solution[:, 0] if solved else solve(matrix, right))
