"""A small convolutional network in ONNX, run by OpenCV on the processor."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError


class Network:
    """A network with one input `(B, 1, H, W)` and named outputs.

    An instance is not to be shared between threads: OpenCV keeps a call's buffers in it.

    Raises
    ------
    ModelError
        Where OpenCV cannot read the network.
    """

    def __init__(self, onnx: bytes, *outputs: str) -> None:
        self.onnx = onnx
        self._outputs = list(outputs)
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(onnx, np.uint8))
        except cv2.error as error:
            raise ModelError(
                f"OpenCV {cv2.__version__} cannot read a network of the tracker's model. "
                "Install opencv-contrib-python-headless 4.11, or reinstall Facemime."
            ) from error

    def __call__(self, pictures: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """Outputs for standardised pictures (B, H, W), in the order in which they were named."""
        self._net.setInput(pictures[:, None])
        return tuple(np.asarray(out, np.float32) for out in self._net.forward(self._outputs))
