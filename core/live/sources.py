"""What a live session looks at, each frame when its time has come: a video, pictures, a take; `camera` has the camera.

Unlike `capture.VideoSource`, which gives every frame as fast as it is asked, these keep to the clock and drop what is
late: a puppet that follows an old frame is worse than one that skipped it.
"""

from __future__ import annotations

import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..capture import VideoSource
from ..errors import SourceError
from ..images import IMAGE_SUFFIXES, read_image
from ..takes.take import Take
from ..tracking.result import TrackResult

_LATEST = 1.0
"""Seconds by which frames may be late before the clock is set back instead: after a computer's sleep, say."""
_CATCHING_UP = 0.1
"""Seconds that leaving late frames out may take: what is read more slowly than it plays would only get later."""


@dataclass(frozen=True)
class LiveFrame:
    """One frame as it reaches the worker.

    Attributes
    ----------
    time : float
        Seconds from the first frame, strictly increasing, also where a recording starts over.
    image : (H, W, 3) uint8 or None
        BGR; None for a frame of a take.
    result : TrackResult or None
        What a take knows of the frame already.
    taken : float
        `time.perf_counter()` when it was there; latency counts from here.
    dropped : int
        Frames left out since the last one, as they came too fast.
    """

    time: float
    image: NDArray[np.uint8] | None
    result: TrackResult | None = None
    taken: float = 0.0
    dropped: int = 0


class LiveSource(ABC):
    """Where a live session's frames come from. `read` is called by one thread, `close` by any.

    Attributes
    ----------
    name : str
        For messages.
    clock : str
        What `LiveFrame.time` counts: "media" or "monotonic".
    ended : bool
        Whether no frame will come any more.
    """

    name: str
    clock = "media"
    ended = False

    @abstractmethod
    def read(self, timeout: float) -> LiveFrame | None:
        """The newest frame; None where none came within `timeout` seconds, or the source has ended or is closed.

        Raises
        ------
        SourceError
            Where the source cannot be opened or has gone; the next call tries again.
        """

    @abstractmethod
    def close(self) -> None:
        """Release it and wake a `read` that waits; may be called twice."""


class Clock:
    """The time that a `PacedSource` keeps to: the computer's, or one whose seconds pass on request, for tests."""

    def now(self) -> float:
        """Seconds since some moment."""
        return perf_counter()

    def wait_until(self, due: float, timeout: float, closed: threading.Event) -> bool:
        """Wait for `due`, `timeout` seconds at most, or until `closed` is set; whether it came within that time."""
        ahead = due - self.now()
        closed.wait(min(max(ahead, 0.0), timeout))
        return ahead <= timeout


class PacedSource(LiveSource):
    """Something recorded, played by the clock; what came due meanwhile is dropped.

    Parameters
    ----------
    loop : bool
        Start over at the end.
    speed : float
        1 is as recorded.

    Attributes
    ----------
    pace : Clock
        Shared by all sources; may be another one before the first `read`.
    """

    pace = Clock()

    def __init__(self, name: str, *, loop: bool = False, speed: float = 1.0) -> None:
        if not 0.01 <= speed <= 100.0:
            raise SourceError(f"The speed must lie between 0.01 and 100; got {speed:g}. Take 1 for as recorded.")
        self.name = name
        self._loop, self._speed = loop, speed
        self._closed = threading.Event()
        self._frames: Iterator[LiveFrame] | None = None
        self._next: LiveFrame | None = None
        self._began = 0.0
        self._offset = 0.0

    @abstractmethod
    def frames(self) -> Iterator[LiveFrame]:
        """All frames from the first, whose time is 0."""

    def read(self, timeout: float) -> LiveFrame | None:
        """The newest frame that has come due; see `LiveSource.read`."""
        if self._frames is None and not self.ended:
            self._start()
        if self._next is None or not self._wait(timeout):
            return None
        now, shown, dropped = self.pace.now(), self._next, -1
        self._began += max(0.0, now - self._due(shown) - _LATEST)
        while self._next is not None and self._due(self._next) <= now:
            shown, dropped = self._next, dropped + 1
            self._advance()
            if (late := self.pace.now()) - now > _CATCHING_UP:
                self._began = late - shown.time / self._speed
                break
        return replace(shown, taken=perf_counter(), dropped=dropped)

    def close(self) -> None:
        """Stop; a waiting `read` returns None."""
        self._closed.set()

    def _start(self) -> None:
        self._frames = self._repeated()
        self._advance()
        if self._next is not None:
            self._began = self.pace.now() - self._next.time / self._speed

    def _repeated(self) -> Iterator[LiveFrame]:
        """The frames, over and over where they loop, in one growing time."""
        while True:
            last, step, start = 0.0, 1.0 / 30.0, self._offset
            for frame in self.frames():
                step, last = (frame.time - last) or step, frame.time
                self._offset = start + last + step
                yield replace(frame, time=start + frame.time)
            if not self._loop:
                return

    def _advance(self) -> None:
        assert self._frames is not None
        try:
            self._next = next(self._frames, None)
        except SourceError:
            self._frames = self._next = None
            raise
        self.ended = self._next is None

    def _due(self, frame: LiveFrame) -> float:
        return self._began + frame.time / self._speed

    def _wait(self, timeout: float) -> bool:
        """Whether the next frame came due within `timeout`, and nobody closed the source."""
        assert self._next is not None
        came = self.pace.wait_until(self._due(self._next), timeout, self._closed)
        return came and not self._closed.is_set()


class VideoPlayer(PacedSource):
    """A video file, as `capture.VideoSource` reads it."""

    def __init__(self, path: Path, *, loop: bool = False, speed: float = 1.0) -> None:
        super().__init__(Path(path).name, loop=loop, speed=speed)
        self._path = Path(path)

    def frames(self) -> Iterator[LiveFrame]:
        """All frames of the file."""
        with VideoSource(self._path) as source:
            for frame in source:
                yield LiveFrame(frame.time, frame.image)


class PicturePlayer(PacedSource):
    """The pictures of a folder in the order of their names, at `rate` frames a second."""

    def __init__(self, folder: Path, *, rate: float = 25.0, loop: bool = False, speed: float = 1.0) -> None:
        super().__init__(Path(folder).name, loop=loop, speed=speed)
        if not 0.1 <= rate <= 1000.0:
            raise SourceError(f"The rate must lie between 0.1 and 1000 frames a second; got {rate:g}.")
        self._folder, self._rate = Path(folder), rate

    def frames(self) -> Iterator[LiveFrame]:
        """All pictures of the folder; one that cannot be read is left out, as a camera's lost frame is."""
        if not os.path.isdir(self._folder):
            raise SourceError(f"There is no folder {self._folder}. Choose the folder that holds the pictures.")
        paths = sorted(path for path in self._folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        if not paths:
            raise SourceError(f"There is no picture in {self._folder}. JPEG, PNG, BMP, TIFF and WebP are read.")
        unreadable: SourceError | None = None
        shown = 0
        for path in paths:
            try:
                image = read_image(path)
            except SourceError as error:
                unreadable = error
                continue
            yield LiveFrame(shown / self._rate, image)
            shown += 1
        if not shown and unreadable is not None:
            raise unreadable


class TakePlayer(PacedSource):
    """A take: what was tracked once is shown again, without an image."""

    def __init__(self, take: Take, name: str, *, loop: bool = False, speed: float = 1.0) -> None:
        super().__init__(name, loop=loop, speed=speed)
        self._take = take

    def frames(self) -> Iterator[LiveFrame]:
        """All frames of the take."""
        for index, time in enumerate((self._take.times - self._take.times[0]).tolist()):
            yield LiveFrame(time, None, self._take.result(index))
