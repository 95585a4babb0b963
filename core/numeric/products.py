"""Products of matrices without a BLAS.

numpy multiplies large matrices fast only with a BLAS. Blender's own numpy is built without one, and takes twenty to
fifty times as long; OpenCV brings kernels that take about as long as a BLAS. Elsewhere, a BLAS shares even products of
ten thousand numbers among its threads, which on a busy machine wait for each other for a millisecond.
"""

from __future__ import annotations

from threading import local

import cv2
import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray
from .onnx import Node, encode_network
from .opencv import read_network

_KEPT = local()
"""OpenCV keeps the buffers of a call in a network, so each thread has its own."""
_KEPT_SIZE = 1 << 20
"""Largest number of entries of a matrix after which the network is kept."""


def dot(left: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply vectors by a small matrix, or take their products with a vector, in this thread alone.

    Parameters
    ----------
    left : (..., K) array
        The vectors.
    right : (K,) or (K, N) array
        The vector or matrix.

    Returns
    -------
    (...,) or (..., N) array
        ``left @ right``, in at most twice the time that a BLAS takes on an idle machine.
    """
    product: FloatArray = np.einsum("...k,k->..." if right.ndim == 1 else "...k,kn->...n", left, right)
    return product


def multiply(left: FloatArray, right: FloatArray, *, transposed: bool = False) -> NDArray[np.float32]:
    """Multiply two large matrices, or the matrices of two stacks, by OpenCV, in single precision.

    Parameters
    ----------
    left : (M, K) or (B, M, K) array
        `A`.
    right : (K, N) or (B, K, N) array; (N, K) if transposed
        `B`.
    transposed : bool
        Whether to return ``A B^T`` rather than ``A B``; not for stacks.

    Returns
    -------
    (M, N) or (B, M, N) float32
        The product.
    """
    if not left.size or not right.size:
        return np.zeros((*left.shape[:-1], len(right) if transposed else right.shape[-1]), np.float32)
    name = f"{left.ndim} {transposed}"
    network = getattr(_KEPT, name, None) or _network(left.ndim, transposed)
    for side, values in (("left", left), ("right", right)):
        network.setInput(np.ascontiguousarray(values, dtype=np.float32), side)
    product = np.asarray(network.forward())
    # Its buffers remain as large as the last product.
    setattr(_KEPT, name, network if max(left.size, right.size, product.size) <= _KEPT_SIZE else None)
    return product


def _network(dimensions: int, transposed: bool) -> cv2.dnn.Net:
    """Return a network for products of matrices or of stacks."""
    sides = ("left", "right")
    node = Node("MatMul", sides, "product")
    if dimensions == 2:
        node = Node("Gemm", sides, "product", {"transB": int(transposed)})
    return read_network(encode_network([node], dict.fromkeys(sides, (1,) * dimensions)))
