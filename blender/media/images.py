"""Image data-blocks from arrays."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray


def keep_picture(name: str, picture: NDArray[np.uint8]) -> bpy.types.Image:
    """Create an image data-block, packed into the .blend file.

    Parameters
    ----------
    name : str
        An image of the same name is replaced.
    picture : (H, W, 3) uint8
        BGR, first row at the top.
    """
    if (old := bpy.data.images.get(name)) is not None:
        bpy.data.images.remove(old)
    height, width = picture.shape[:2]
    image = bpy.data.images.new(name, width, height)
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = picture[::-1, :, ::-1] / np.float32(255.0)
    image.pixels.foreach_set(pixels.reshape(-1))
    image.pack()
    return image
