"""What the camera saw, kept beside a take: to look at while animating, and to track again.

It is written by a process of its own (`video_process`): a video's last seconds wait in memory to be packed, and only a
program that outlives a crash of Blender can still write them.
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
"""Of the container: what is written of it can be played although its end was never written."""
PROGRAM = Path(__file__).with_name("video_process.py")
_ROOM = 1 << 28
"""Bytes of frames that may wait to be packed; those behind them are left out, and the one before them shown instead."""
_ENDING = 20.0
"""Seconds to wait for the last frames to be written; after that they are written while the user goes on."""


class ReferenceVideo:
    """A video that is written beside the program, until `close`.

    Parameters
    ----------
    path : Path
        Of the file, ending in `SUFFIX`; made with the first frame.
    fps : float
        Of the file.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self.fps = path, fps
        self._waiting: SimpleQueue[tuple[float, NDArray[np.uint8]] | None] = SimpleQueue()
        self._bytes = 0
        self._counting = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="facemime-video", daemon=True)
        self._thread.start()

    def add(self, time: float, image: NDArray[np.uint8]) -> None:
        """Take in a frame, (H, W, 3) BGR or (H, W) grey, seen `time` seconds after the first; never waits."""
        if self._bytes + image.nbytes <= _ROOM and self._thread.is_alive():
            self._count(image.nbytes)
            self._waiting.put((time, image.copy()))

    def close(self) -> None:
        """Write what waits, and end the file."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join(_ENDING)

    @property
    def written(self) -> bool:
        """Whether there is a file with something in it."""
        return self.path.is_file() and self.path.stat().st_size > 0

    def _count(self, added: int) -> None:
        with self._counting:
            self._bytes += added

    def _work(self) -> None:
        with contextlib.suppress(OSError, SourceError):  # `written` says so
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
