"""Make the README's picture of a real performer: `python tools/real_picture.py VIDEO HEAD OUT.jpg`.

The video is by Wolfgang Langer (Pexels), of which frames may be shown with his name.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2

FIRST = 9.4
"""Start in seconds: from a calm face to a laugh."""
ROWS = 2
"""Rows of the contact sheet that are kept, from its end."""
OF = 3
WIDTH = 1400
QUALITY = 88


def main(video: Path, head: Path, out: Path) -> int:
    """Write the picture; return the exit status."""
    with tempfile.TemporaryDirectory() as folder:
        clip, sheet = Path(folder) / "clip.mp4", Path(folder) / "sheet.png"
        cut(video, clip)
        command = [
            sys.executable,
            "-m",
            "facemime.cli",
            "puppet",
            clip,
            "--head",
            head,
            "-o",
            clip.with_suffix(".blend"),
        ]
        subprocess.run([*map(str, command), "--sheet", str(sheet)], check=True)
        picture = cv2.imread(str(sheet))
    kept = picture[picture.shape[0] * (OF - ROWS) // OF :]
    size = (WIDTH, round(WIDTH * kept.shape[0] / kept.shape[1]))
    cv2.imwrite(str(out), cv2.resize(kept, size, interpolation=cv2.INTER_AREA), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return 0


def cut(video: Path, clip: Path) -> None:
    """Write the frames of a video from `FIRST` on as a clip."""
    source = cv2.VideoCapture(str(video))
    rate = source.get(cv2.CAP_PROP_FPS)
    size = (int(source.get(cv2.CAP_PROP_FRAME_WIDTH)), int(source.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    writer, number = cv2.VideoWriter(str(clip), cv2.VideoWriter.fourcc(*"mp4v"), rate, size), 0
    while (read := source.read())[0]:
        if number >= FIRST * rate:
            writer.write(read[1])
        number += 1
    writer.release()


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:4])))
