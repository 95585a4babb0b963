"""Products with constant matrices as a network in ONNX format, for OpenCV to run.

numpy multiplies matrices fast only with a BLAS. Blender's own numpy is built without one, and then takes more than ten
times as long; OpenCV brings its own kernels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_Field = tuple[int, int | str | bytes]
"""Number and value of a field."""
_IR_VERSION, _OPSET = 8, 13
_FLOAT = 1
"""`TensorProto.DataType.FLOAT`."""


def rectified_products(matrices: NDArray[np.float32]) -> bytes:
    """Encode ``max(0, x_n M_n)`` for constant matrices.

    Parameters
    ----------
    matrices : (N, A, B) float32
        `M`.

    Returns
    -------
    bytes
        A network in ONNX format, from an input of shape (N, 1, R, A) to the output `rectified` of shape (N, 1, R, B).

    Notes
    -----
    The fields of the messages, by number, are those of onnx.proto3 (ONNX 1.17).
    """
    count, inner, columns = matrices.shape
    shape = (count, 1, inner, columns)
    constant: list[_Field] = [
        *((1, side) for side in shape),
        (2, _FLOAT),
        (8, "matrices"),
        (9, matrices.astype("<f4").tobytes()),
    ]
    product: list[_Field] = [(1, "input"), (1, "matrices"), (2, "products"), (4, "MatMul")]
    rectified: list[_Field] = [(1, "products"), (2, "rectified"), (4, "Relu")]
    graph: list[_Field] = [(1, _message(product)), (1, _message(rectified)), (2, "products"), (5, _message(constant))]
    graph += [(11, _value("input", (count, 1, 1, inner))), (12, _value("rectified", (count, 1, 1, columns)))]
    return _message([(1, _IR_VERSION), (7, _message(graph)), (8, _message([(1, ""), (2, _OPSET)]))])


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    """Encode the name and shape of an input or output, a `ValueInfoProto`."""
    sides = _message([(1, _message([(1, side)])) for side in shape])
    return _message([(1, name), (2, _message([(1, _message([(1, _FLOAT), (2, sides)]))]))])


def _message(fields: Sequence[_Field]) -> bytes:
    """Encode a message of Protocol Buffers from numbered fields."""
    out = bytearray()
    for number, value in fields:
        if isinstance(value, int):
            out += _varint(number << 3) + _varint(value)
        else:
            data = value.encode() if isinstance(value, str) else value
            out += _varint(number << 3 | 2) + _varint(len(data)) + data
    return bytes(out)


def _varint(value: int) -> bytes:
    """Encode a non-negative integer in groups of seven bits, the lowest first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
