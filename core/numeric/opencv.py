"""OpenCV as it is installed, and small networks in ONNX format for it to run, encoded without the library of that
format.

Blender keeps the wheels of all extensions in one folder, so another may replace OpenCV.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import Message, ModelError

_SUPPORTED = (4, 11), (5, 0)
"""The oldest supported version, and the first that is not: it has other networks and no cascades."""


def silence_opencv() -> None:
    """Turn off OpenCV's own messages in the terminal, as its failures are reported otherwise."""
    getattr(cv2.utils, "logging", cv2).setLogLevel(0)  # it moved in 4.12


def read_network(onnx: bytes) -> cv2.dnn.Net:
    """Read a network in ONNX format.

    Raises ModelError if this version of OpenCV is not supported, or cannot read the network.
    """
    version = tuple(int(part) for part in re.findall(r"\d+", cv2.__version__)[:2])
    if not _SUPPORTED[0] <= version < _SUPPORTED[1]:
        raise ModelError(
            "OpenCV {version} is installed, but Facemime needs 4.11. "
            "Disable other extensions that contain OpenCV, and restart Blender.",
            version=cv2.__version__,
        )
    try:
        return cv2.dnn.readNetFromONNX(np.frombuffer(onnx, np.uint8))
    except cv2.error as error:
        raise network_error(Message("read")) from error


def network_error(what: str) -> ModelError:
    """Return the error for a network that OpenCV cannot `what` ("read" or "run")."""
    return ModelError(
        "OpenCV {version} cannot {what} a network of the tracker model. "
        "Install opencv-contrib-python-headless 4.11, or reinstall Facemime.",
        version=cv2.__version__,
        what=what,
    )


_Field = tuple[int, int | str | bytes]
"""Number and value of a field of a message, by onnx.proto3 of ONNX 1.17."""
_IR_VERSION = 8
"""Version of the file format."""
_OPSET = 13
"""Version of the set of operators."""
_FLOAT = 1
"""`TensorProto.DataType.FLOAT`."""
_INT = 2
"""`AttributeProto.AttributeType.INT`."""


@dataclass(frozen=True)
class Node:
    """An operation of a network.

    Attributes
    ----------
    operator : str
        Name of an operator of ONNX.
    inputs : tuple of str
        Names of its inputs: results, inputs of the network or constants.
    output : str
        Name of its result.
    options : mapping of str to int
        Attributes of the operator.
    """

    operator: str
    inputs: tuple[str, ...]
    output: str
    options: Mapping[str, int] = field(default_factory=dict)


def encode_network(
    nodes: Sequence[Node],
    inputs: Mapping[str, tuple[int, ...]],
    constants: Mapping[str, NDArray[np.float32]] | None = None,
) -> bytes:
    """Encode a network whose output is the result of its last node; each node follows those whose results it uses.

    The inputs are shapes; OpenCV accepts others with as many dimensions.
    """
    graph: list[_Field] = [(1, _node(node)) for node in nodes]
    graph += [(2, "network")]
    graph += [(5, _constant(name, values)) for name, values in (constants or {}).items()]
    graph += [(11, _value(name, shape)) for name, shape in inputs.items()]
    graph += [(12, _value(nodes[-1].output, ()))]
    return _message([(1, _IR_VERSION), (7, _message(graph)), (8, _message([(1, ""), (2, _OPSET)]))])


def _node(node: Node) -> bytes:
    fields: list[_Field] = [(1, name) for name in node.inputs]
    fields += [(2, node.output), (3, node.output), (4, node.operator)]
    fields += [(5, _message([(1, name), (3, value), (20, _INT)])) for name, value in node.options.items()]
    return _message(fields)


def _constant(name: str, values: NDArray[np.float32]) -> bytes:
    fields: list[_Field] = [(1, side) for side in values.shape]
    fields += [(2, _FLOAT), (8, name), (9, values.astype("<f4").tobytes())]
    return _message(fields)


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    sides = _message([(1, _message([(1, side)])) for side in shape])
    return _message([(1, name), (2, _message([(1, _message([(1, _FLOAT), (2, sides)]))]))])


def _message(fields: Sequence[_Field]) -> bytes:
    """Encode a message of Protocol Buffers."""
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
