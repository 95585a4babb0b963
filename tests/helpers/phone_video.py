"""MP4 files whose frames come at given times, as phones write them, which skip frames in the dark."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

_CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")


def phone_video(path: Path, steps: Sequence[float]) -> Path:
    """Write a clip whose frames, one more than `steps`, are that many seconds apart; it states the mean rate."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (64, 48))
    for number in range(len(steps) + 1):
        writer.write(np.full((48, 64, 3), number % 200, np.uint8))
    writer.release()
    # The index follows the images, so that their places in the file stay.
    path.write_bytes(_with_steps(path.read_bytes(), [*steps, float(np.median(steps))], [0]))
    return path


def _with_steps(data: bytes, steps: Sequence[float], scale: list[int]) -> bytes:
    written, at = b"", 0
    while at < len(data):
        (size,), kind = struct.unpack_from(">I", data, at), data[at + 4 : at + 8]
        content = data[at + 8 : at + size]
        if kind in _CONTAINERS:
            content = _with_steps(content, steps, scale)
        elif kind == b"mdhd":
            (scale[0],) = struct.unpack_from(">I", content, 12)
            content = content[:16] + struct.pack(">I", sum(_ticks(steps, scale[0]))) + content[20:]
        elif kind == b"stts":
            pairs = b"".join(struct.pack(">II", 1, tick) for tick in _ticks(steps, scale[0]))
            content = struct.pack(">II", 0, len(steps)) + pairs
        elif kind == b"edts":  # it states the old duration
            kind = b"free"
        written += struct.pack(">I", len(content) + 8) + kind + content
        at += size
    return written


def _ticks(steps: Sequence[float], scale: int) -> list[int]:
    times = np.round(scale * np.cumsum([0.0, *steps])).astype(int)
    return np.diff(times).tolist()
