"""A small convolutional network in ONNX format, run by OpenCV on the CPU."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message
from ..numeric.opencv import network_error, read_network


class Network:
    """A network with one input `(B, 1, H, W)` and named outputs.

    Do not share an instance between threads, as OpenCV keeps the buffers of a call in it.

    Raises
    ------
    ModelError
        As `read_network`.
    """

    def __init__(self, onnx: bytes, *outputs: str) -> None:
        self.onnx = onnx
        self._outputs = list(outputs)
        self._net = read_network(onnx)

    def __call__(self, images: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """Return the outputs for standardised images (B, H, W), in the order of their names."""
        try:
            self._net.setInput(images[:, None])
            return tuple(np.asarray(out, np.float32) for out in self._net.forward(self._outputs))
        except cv2.error as error:
            raise network_error(Message("run")) from error

    def check(self, size: tuple[int, int], *shapes: tuple[int, ...]) -> None:
        """Check the shapes of the outputs.

        Parameters
        ----------
        size : (int, int)
            Width and height of the input image in pixels.
        *shapes : tuple of int
            Expected shape of each output.

        Raises
        ------
        ValueError
            If an output has another shape or is not finite.
        """
        outputs = self(np.zeros((1, *size[::-1]), np.float32))
        for name, output, shape in zip(self._outputs, outputs, shapes, strict=True):
            if output.shape != shape or not np.isfinite(output).all():
                raise DataError(
                    "output {name} of a network has the shape {shape}, not {expected}, or is not finite",
                    name=name,
                    shape=output.shape,
                    expected=shape,
                )
