"""Reference video: the camera's frames, stored beside a take for viewing and for tracking again.

It is written by a separate process (`video_process`): the last seconds of a video wait in memory to be encoded, and
only a process that survives a crash of Blender can still write them.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
from pathlib import Path
from queue import SimpleQueue

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import SourceError
from .camera import module_folders, python_executable
from .video_process import HEADER

SUFFIX = ".mkv"
"""Suffix of the container, which can be played even if its end was never written."""
PROGRAM = Path(__file__).with_name("video_process.py")
_ROOM = 1 << 28
"""Bytes of frames that may wait to be encoded. Further frames are dropped, and the frame before is repeated."""
_ENDING = 20.0
"""Seconds that `close` waits for the last frames. After that they are written in the background."""


class ReferenceVideo:
    """A video that is written in the background, until `close`.

    The file, with `SUFFIX`, is created with the first frame.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self.fps = path, fps
        self._waiting: SimpleQueue[tuple[float, NDArray[np.uint8]] | None] = SimpleQueue()
        self._bytes = 0
        self._counting = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="facemime-video", daemon=True)
        self._thread.start()

    def add(self, time: float, image: NDArray[np.uint8]) -> None:
        """Add an image, BGR (H, W, 3) or grey (H, W), without waiting, at a time in seconds since the first one."""
        if self._bytes + image.nbytes <= _ROOM and self._thread.is_alive():
            self._count(image.nbytes)
            self._waiting.put((time, image.copy()))

    def close(self) -> None:
        """Write pending frames, and end the file."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join(_ENDING)

    @property
    def written(self) -> bool:
        """Whether the file exists and is not empty."""
        return self.path.is_file() and self.path.stat().st_size > 0

    def _count(self, added: int) -> None:
        with self._counting:
            self._bytes += added

    def _work(self) -> None:
        with contextlib.suppress(OSError, SourceError):  # `written` is false then
            command = [python_executable(), "-s", str(PROGRAM), module_folders(), os.fspath(self.path), str(self.fps)]
            quiet = subprocess.DEVNULL
            with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet) as process:
                assert process.stdin is not None
                while (item := self._waiting.get()) is not None:
                    time, image = item
                    self._count(-image.nbytes)
                    colour = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
                    process.stdin.write(HEADER.pack(time, *colour.shape[:2]))
                    process.stdin.write(np.ascontiguousarray(colour).data)
                    process.stdin.flush()
