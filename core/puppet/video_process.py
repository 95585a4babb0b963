"""A separate process that writes the frames from its standard input to a video.

Usage: python video_process.py FOLDERS PATH FPS, where FOLDERS contain cv2 and numpy. A message is `HEADER` (seconds
since the first frame, height, width) followed by BGR pixels. When the input ends, which is also when the process that
started it ends, even by a crash, the file is completed. Nothing of Facemime is imported, as its package is not on the
path.

A camera delivers frames at uneven times, a video plays them at even ones. Frames are therefore repeated or dropped, so
that frame n of the file shows what was seen at n / fps seconds.
"""

import os
import signal
import struct
import sys
from collections.abc import Iterator
from typing import Any

HEADER = struct.Struct("<dII")
_CODEC = "mp4v"


def main() -> int:
    """Write until the input ends. The exit status is 1 if the video cannot be written."""
    sys.path[:0] = sys.argv[1].split(os.pathsep)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the process that started this one
    import cv2

    path, fps = sys.argv[2], float(sys.argv[3])
    writer: Any = None
    shown: Any = None
    written = 0
    for time, seen in _frames():
        if writer is None:
            height, width = seen.shape[:2]
            writer = cv2.VideoWriter(path, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*_CODEC), fps, (width, height))
            if not writer.isOpened():
                return 1
            shown = seen
        size = (shown.shape[1], shown.shape[0])
        image = seen if seen.shape == shown.shape else cv2.resize(seen, size)
        # Repeat the last image up to the slot of this one; drop this one if the slot is taken.
        slot = round(time * fps)
        for _ in range(written, slot):
            writer.write(shown)
        if slot >= written:
            writer.write(image)
        written, shown = max(written, slot + 1), image
    if writer is not None:
        writer.release()
    return 0


def _frames() -> Iterator[tuple[float, Any]]:
    import numpy as np

    source = sys.stdin.buffer
    while len(head := source.read(HEADER.size)) == HEADER.size:
        time, height, width = HEADER.unpack(head)
        pixels = source.read(3 * height * width)
        if len(pixels) < 3 * height * width:
            return
        yield time, np.frombuffer(pixels, np.uint8).reshape(height, width, 3)


if __name__ == "__main__":
    sys.exit(main())
