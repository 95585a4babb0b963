"""Pictures and videos to fuzz."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from random import Random

import cv2
import numpy as np

from facemime.core.files.assets import SAMPLE
from facemime.core.files.capture import VideoSource, read_image
from tests.fuzz.mutators import mutated_bytes

_SUFFIXES = (".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm", ".pgm")


@cache
def filmed_face() -> np.ndarray:
    with VideoSource(SAMPLE) as source:
        return cv2.resize(next(iter(source)).image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


@cache
def picture(suffix: str) -> bytes:
    picture = cv2.resize(filmed_face(), (64, 48))
    return bytes(cv2.imencode(suffix, picture[..., 0] if suffix == ".pgm" else picture)[1])


def mutated_picture(rng: Random) -> bytes:
    return mutated_bytes(rng, picture(rng.choice(_SUFFIXES)))


def read_picture(path: Path) -> None:
    image = read_image(path)
    assert image.ndim == 3 and image.size
    cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


@cache
def video() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "clip.mp4")
        out = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48))
        for shift in range(12):
            out.write(np.roll(cv2.resize(filmed_face(), (64, 48)), shift, axis=1))
        out.release()
        return Path(path).read_bytes()


def read_video(path: Path) -> None:
    with VideoSource(path) as source:
        for frame in source:
            assert frame.image.size and np.isfinite(frame.time)
            if frame.index > 50:
                break
