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
            raise _refused("read") from error

    def __call__(self, pictures: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """Outputs for standardised pictures (B, H, W), in the order in which they were named."""
        try:
            self._net.setInput(pictures[:, None])
            return tuple(np.asarray(out, np.float32) for out in self._net.forward(self._outputs))
        except cv2.error as error:
            raise _refused("run") from error

    def check(self, size: tuple[int, int], *shapes: tuple[int, ...]) -> None:
        """Raise ValueError where the outputs for a picture of `size` (width, height) have not these `shapes`."""
        outputs = self(np.zeros((1, *size[::-1]), np.float32))
        for name, output, shape in zip(self._outputs, outputs, shapes, strict=True):
            if output.shape != shape or not np.isfinite(output).all():
                raise ValueError(f"a network gives {name} of the shape {output.shape}, not finite ones of {shape}")


def _refused(what: str) -> ModelError:
    return ModelError(
        f"OpenCV {cv2.__version__} cannot {what} a network of the tracker's model. "
        "Install opencv-contrib-python-headless 4.11, or reinstall Facemime."
    )
