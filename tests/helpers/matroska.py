"""Matroska files with given times, as recorders in browsers write them: without a rate, a duration or sizes."""

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

EBML, SEGMENT, INFO, TRACKS, TRACK, CLUSTER, BLOCK = (
    *(0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0xAE, 0x1F43B675, 0xA3),
)


def element(name: int, content: bytes, *, unknown: bool = False) -> bytes:
    """An element; its length may be unknown, as a recording of a browser has it."""
    size = b"\x01" + (b"\xff" * 7 if unknown else len(content).to_bytes(7, "big"))
    return name.to_bytes((name.bit_length() + 7) // 8, "big") + size + content


def number(name: int, value: int) -> bytes:
    """An element that is a whole number."""
    return element(name, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


def browser_video(
    path: Path, images: Sequence[np.ndarray], times: Sequence[int], shown: tuple[int, int] | None = None
) -> Path:
    """Write images (H, W, 3) with their times in milliseconds, to be displayed at another size if one is given."""
    height, width = images[0].shape[:2]
    sides = number(0xB0, width) + number(0xBA, height)
    if shown is not None:
        sides += number(0x54B0, shown[0]) + number(0x54BA, shown[1])
    head = number(0x4286, 1) + number(0x42F7, 1) + number(0x42F2, 4) + number(0x42F3, 8) + element(0x4282, b"matroska")
    about = number(0x2AD7B1, 1_000_000) + element(0x4D80, b"x") + element(0x5741, b"x")
    track = number(0xD7, 1) + number(0x73C5, 1) + number(0x83, 1) + element(0x86, b"V_MJPEG") + element(0xE0, sides)
    content = element(INFO, about) + element(TRACKS, element(TRACK, track))
    for image, time in zip(images, times, strict=True):
        picture = cv2.imencode(".jpg", image)[1].tobytes()
        block = element(BLOCK, b"\x81" + struct.pack(">h", 0) + b"\x80" + picture)
        content += element(CLUSTER, number(0xE7, time) + block)
    versions = number(0x4287, 4) + number(0x4285, 2)
    path.write_bytes(element(EBML, head + versions) + element(SEGMENT, content, unknown=True))
    return path
