"""What the camera saw, kept beside a take: to look at while animating, and to track again.

A camera gives frames when it can, a video plays them evenly. So a frame goes into the slots of an even grid that its
time covers, and frame n of the file shows what was seen at n / fps seconds, to the last.
"""

from __future__ import annotations

import threading
from pathlib import Path
from queue import Full, Queue

import cv2
import numpy as np
from numpy.typing import NDArray

SUFFIX = ".mkv"
"""Of the container: what is written of it can be played although its end was never written."""
_CODEC = "mp4v"
_WAITING = 32
"""Frames that may wait to be packed; those behind them are left out, and the one before them shown instead."""


class ReferenceVideo:
    """A video that is written in a thread of its own, until `close`.

    Parameters
    ----------
    path : Path
        Of the file, ending in `SUFFIX`; made with the first frame.
    fps : float
        Of the file.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self.fps = path, fps
        self._waiting: Queue[tuple[float, NDArray[np.uint8]] | None] = Queue(_WAITING)
        self._thread = threading.Thread(target=self._work, name="facemime-video", daemon=True)
        self._thread.start()

    def add(self, time: float, image: NDArray[np.uint8]) -> None:
        """Take in a frame, (H, W, 3) BGR or (H, W) grey, seen `time` seconds after the first; never waits."""
        try:
            self._waiting.put_nowait((time, image.copy()))
        except Full:
            return

    def close(self) -> None:
        """Write what waits, and end the file."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()

    @property
    def written(self) -> bool:
        """Whether there is a file with something in it."""
        return self.path.is_file() and self.path.stat().st_size > 0

    def _work(self) -> None:
        writer: cv2.VideoWriter | None = None
        shown: NDArray[np.uint8] | None = None
        written = 0
        while (item := self._waiting.get()) is not None:
            time, image = item
            image = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
            if writer is None or shown is None:
                writer, shown = self._opened(image), image
            if image.shape != shown.shape:
                image = np.asarray(cv2.resize(image, (shown.shape[1], shown.shape[0])), np.uint8)
            slot = round(time * self.fps)
            for _ in range(written, slot):
                writer.write(shown)
            if slot >= written:
                writer.write(image)
            written, shown = max(written, slot + 1), image
        if writer is not None:
            writer.release()

    def _opened(self, image: NDArray[np.uint8]) -> cv2.VideoWriter:
        codec = cv2.VideoWriter.fourcc(*_CODEC)
        height, width = image.shape[:2]
        return cv2.VideoWriter(str(self.path), cv2.CAP_FFMPEG, codec, self.fps, (width, height))
