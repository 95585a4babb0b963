"""Short clips of the sample performer."""

import struct
from pathlib import Path

import cv2
import numpy as np

from tests.helpers.commands import SAMPLE


def write_clips(folder: Path, count: int) -> Path:
    """Write `count` clips of 12 frames, each from a different part of the sample clip."""
    folder.mkdir()
    source = cv2.VideoCapture(str(SAMPLE))
    for number in range(count):
        writer = cv2.VideoWriter(str(folder / f"{number}.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (640, 480))
        for _ in range(12):
            writer.write(source.read()[1])
        writer.release()
    return folder


def write_variable_clip(path: Path, steps: list[int], rate: int = 30) -> np.ndarray:
    """Write a clip whose images, each brighter than the one before, are on display for a number of ticks each.

    OpenCV writes constant rates only, so that the table of durations in its MP4 file is replaced.

    Returns
    -------
    (N,) array
        Times of the images, seconds.
    """
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate, (160, 120))
    for number in range(len(steps)):
        writer.write(np.full((120, 160, 3), 20 + 210 * number // len(steps), np.uint8))
    writer.release()
    data = path.read_bytes()
    place = data.index(b"stts")
    (tick,) = struct.unpack_from(">I", data, place + 16)
    table = struct.pack(">II", 0, len(steps)) + b"".join(struct.pack(">II", 1, step * tick) for step in steps)
    added = len(table) - 16
    data = data[: place + 4] + table + data[place + 20 :]
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        at = data.index(name) - 4
        data = data[:at] + struct.pack(">I", struct.unpack_from(">I", data, at)[0] + added) + data[at + 4 :]
    longer = sum(steps) / len(steps)
    for name, place in ((b"mvhd", 20), (b"tkhd", 24), (b"mdhd", 20)):
        at = data.index(name) + place
        data = data[:at] + struct.pack(">I", round(struct.unpack_from(">I", data, at)[0] * longer)) + data[at + 4 :]
    if b"edts" in data:  # the edit list would cut what is longer
        data = data.replace(b"edts", b"free", 1)
    path.write_bytes(data)
    return np.cumsum([0, *steps[:-1]]) / rate
