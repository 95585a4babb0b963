"""Finding the frame of a video at a time, for the frames of a take that are edited."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .capture import VideoSource
from .closing import Closing

_ROOM = 1 << 27
"""Bytes of the last images that are kept, so that a step back need not decode the video again."""
_BEFORE = 0.5
"""Seconds before a frame that was jumped to in which images are kept as well."""


class FrameFinder(Closing):
    """Finds the frame of a video at a time.

    Frames are decoded one after the other, from the first one again to go far back: few files state well where a frame
    is, so a jump would miss it. A frame on the way costs about a millisecond. Raises SourceError as `VideoSource`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kept: dict[float, NDArray[np.uint8]] = {}
        self._open()

    def _open(self) -> None:
        self._video = VideoSource(self._path)
        self._times = self._video.times()
        self._time = -np.inf

    def at(self, seconds: float) -> NDArray[np.uint8] | None:
        """Return the image of the frame nearest to a time from the first frame, (H, W, 3) BGR, or None.

        Raises SourceError if the file can no longer be read.
        """
        near = 0.5 / self._video.fps
        if (kept := self._nearest(seconds, near)) is not None:
            return kept
        if self._time > seconds - near:
            self.close()
            self._open()
        for time in self._times:
            self._time = time
            if time >= seconds - _BEFORE and (image := self._video.image()) is not None:
                self._keep(time, image)
            if time >= seconds - near:
                break
        return self._nearest(seconds, near)

    def _nearest(self, seconds: float, near: float) -> NDArray[np.uint8] | None:
        time = min(self._kept, key=lambda time: abs(time - seconds), default=np.inf)
        return self._kept[time] if abs(time - seconds) <= near else None

    def _keep(self, time: float, image: NDArray[np.uint8]) -> None:
        self._kept.pop(time, None)
        self._kept[time] = image
        while len(self._kept) > 1 and sum(kept.nbytes for kept in self._kept.values()) > _ROOM:
            del self._kept[next(iter(self._kept))]

    def close(self) -> None:
        """Release the file; may be called twice."""
        self._video.close()
