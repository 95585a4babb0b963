"""Short clips of the sample performer."""

from pathlib import Path

import cv2

from commands import SAMPLE


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
