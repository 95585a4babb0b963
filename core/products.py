"""Large products of matrices in single precision, by OpenCV.

numpy multiplies matrices fast only with a BLAS. Blender's own numpy is built without one, and takes twenty to fifty
times as long; OpenCV brings kernels that take about as long as a BLAS.
"""

from __future__ import annotations

from threading import local

import cv2
import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray
from .onnx import Node, encode_network

_KEPT = local()
"""OpenCV keeps the buffers of a call in a network, so each thread has its own."""


def multiply(left: FloatArray, right: FloatArray, *, transposed: bool = False) -> NDArray[np.float32]:
    """Multiply two matrices.

    Parameters
    ----------
    left : (M, K) array
        `A`.
    right : (K, N) array, or (N, K) if transposed
        `B`.
    transposed : bool
        Whether to return ``A B^T`` rather than ``A B``.

    Returns
    -------
    (M, N) float32
        The product.
    """
    if not left.size or not right.size:
        return np.zeros((len(left), len(right) if transposed else right.shape[1]), np.float32)
    name = "transposed" if transposed else "plain"
    network = getattr(_KEPT, name, None)
    if network is None:
        node = Node("Gemm", ("left", "right"), "product", {"transB": int(transposed)})
        encoded = encode_network([node], {"left": (1, 1), "right": (1, 1)})
        network = cv2.dnn.readNetFromONNX(np.frombuffer(encoded, np.uint8))
        setattr(_KEPT, name, network)
    for side, values in (("left", left), ("right", right)):
        network.setInput(np.ascontiguousarray(values, dtype=np.float32), side)
    return np.asarray(network.forward())
