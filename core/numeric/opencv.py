"""OpenCV as it is installed. Blender keeps the wheels of all extensions in one folder, so another may replace it."""

from __future__ import annotations

import re

import cv2
import numpy as np

from ..errors import Message, ModelError

_SUPPORTED = (4, 11), (5, 0)
"""The oldest supported version, and the first that is not: it has other networks and no cascades."""


def silence_opencv() -> None:
    """Turn off OpenCV's own messages in the terminal, as its failures are reported otherwise."""
    getattr(cv2.utils, "logging", cv2).setLogLevel(0)  # it moved in 4.12


def read_network(onnx: bytes) -> cv2.dnn.Net:
    """Read a network in ONNX format.

    Raises
    ------
    ModelError
        If this version of OpenCV is not supported, or cannot read the network.
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
