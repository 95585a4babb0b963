"""Make the README's moving picture, five seconds of a video: `python tools/moving_picture.py VIDEO OUT.webp`."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2

FIRST = 1.5
"""Start in seconds: from there on, the sample clip smiles, opens the mouth and raises the brows."""
SECONDS = 5.0
RATE = 12.5
"""Frames per second: every second one of the sample clip's."""
WIDTH = 720
QUALITY = 85
"""WebP's quality: 0.6 MB, which a page on a slow line can bear; below 80, blocks are visible on the skin."""


def main(video: Path, out: Path) -> int:
    """Write the picture; return the exit status."""
    source = cv2.VideoCapture(str(video))
    step = source.get(cv2.CAP_PROP_FPS) / RATE
    first = round(FIRST * source.get(cv2.CAP_PROP_FPS))
    wanted = {round(first + step * i) for i in range(round(SECONDS * RATE))}
    frames, number = [], 0
    while number <= max(wanted):
        read, image = source.read()
        if not read:
            break
        if number in wanted:
            size = (WIDTH, round(WIDTH * image.shape[0] / image.shape[1]))
            frames.append(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        number += 1
    if not frames:
        print(f"{video} has no frames after {FIRST} s.", file=sys.stderr)
        return 1
    animation = cv2.Animation()
    animation.frames, animation.durations = frames, [round(1000 / RATE)] * len(frames)
    cv2.imwriteanimation(str(out), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
