"""Phone videos, which are stored rotated, with their orientation in the metadata."""

import struct
from pathlib import Path

import cv2
import numpy as np


def turned_clip(path: Path, turn: int, count: int = 3, *, mirrored: bool = False, codec: str = "mp4v") -> Path:
    """A clip that is bright at the top, grey at the left, to be displayed mirrored from top to bottom if `mirrored` is
    set, and rotated clockwise by `turn` degrees.
    """
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 20.0, (64, 48))
    for _ in range(count):
        image = np.zeros((48, 64, 3), np.uint8)
        image[:, :16] = 96
        image[:12] = 255
        writer.write(image)
    writer.release()
    cos, sin = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[turn]
    side = -1 if mirrored else 1
    matrix = struct.pack(">9i", cos << 16, sin << 16, 0, -sin * side << 16, cos * side << 16, 0, 0, 0, 1 << 30)
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 44
    data[at : at + len(matrix)] = matrix
    path.write_bytes(data)
    return path
