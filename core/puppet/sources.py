"""Sources of live frames: videos, images and takes, played in real time; for cameras see `camera`.

Unlike `capture.VideoSource`, which delivers every frame on request, these sources keep to the clock and drop late
frames, as following an old frame is worse than skipping it.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..errors import Message, SourceError
from ..files.capture import PICTURE_RATE, PictureSource, VideoSource
from ..takes.neutral import Neutral, calibrate
from ..takes.take import Take
from ..tracking.result import TrackResult

_LATEST = 1.0
"""Seconds by which frames may be late before the clock is set back, for instance after the computer slept."""
_CATCHING_UP = 0.1
"""Seconds that skipping late frames may take. A video that is read more slowly than it plays would never catch up."""


@dataclass(frozen=True)
class LiveFrame:
    """A frame for the worker.

    Attributes
    ----------
    time : float
        Time in seconds from the first frame, strictly increasing even if a recording loops.
    image : (H, W, 3) uint8 or None
        BGR; None for a frame of a take.
    result : TrackResult or None
        Result of the frame, if the source has one, as a take does.
    taken : float
        `time.perf_counter()` when the frame arrived, from which latency is measured.
    dropped : int
        Number of frames dropped since the last one because they came too fast.
    neutral : Neutral or None
        Neutral face of a source that measures faces or states coefficients rather than tracks them.
    filled : bool
        Whether the source filled in the frame because none came. It is displayed, but not recorded.
    rest : float
        Share by which the face has returned to rest, 0 to 1, after the source stopped sending.
    performer : int
        Number of the performer, in a source with several.
    heads : tuple of int or None
        The heads that this performer drives; None for all.
    sender : str
        Name of the sender, in a source with several.
    size : (int, int) or None
        Width and height in pixels of the image in which `result` was found, if it is known.
    """

    time: float
    image: NDArray[np.uint8] | None
    result: TrackResult | None = None
    taken: float = 0.0
    dropped: int = 0
    neutral: Neutral | None = None
    filled: bool = False
    rest: float = 0.0
    performer: int = 0
    heads: tuple[int, ...] | None = None
    sender: str = ""
    size: tuple[int, int] | None = None

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height in pixels of the image, or of that in which the result was found; None if unknown."""
        return self.size if self.image is None else (self.image.shape[1], self.image.shape[0])


class LiveSource(ABC):
    """A source of frames for a live session. `read` is called by one thread, `close` by any.

    Attributes
    ----------
    name : str
        Name for messages.
    clock : str
        Clock of `LiveFrame.time`: "media" or "monotonic".
    complete : bool
        Whether the whole performance is known in advance, so that its neutral face need not be learnt.
    ended : bool
        Whether there are no more frames.
    message : str
        Reason why no frames come although nothing is wrong here; otherwise "".
    """

    name: str
    clock = "media"
    complete = False
    ended = False
    message = ""

    @property
    def waiting(self) -> str:
        """What to show until the first frame."""
        return Message("Waiting for the first frame")

    @abstractmethod
    def read(self, timeout: float) -> LiveFrame | None:
        """Return the newest frame, or None if none came within `timeout` seconds or the source has ended or is closed.

        Raises SourceError if the source cannot be opened or is gone. The next call tries again.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the source and wake a waiting `read`. May be called twice."""


class Clock:
    """The clock of a `PacedSource`; tests replace it by one that advances on request."""

    def now(self) -> float:
        """Return the seconds since an arbitrary moment."""
        return perf_counter()

    def wait_until(self, due: float, timeout: float, closed: threading.Event) -> bool:
        """Wait for a moment on the scale of `now`, and return whether it came within `timeout` seconds.

        `closed` ends the wait when set.
        """
        ahead = due - self.now()
        closed.wait(min(max(ahead, 0.0), timeout))
        return ahead <= timeout


class PacedSource(LiveSource):
    """A recorded source, played in real time. Late frames are dropped.

    Parameters
    ----------
    name : str
        Name for messages.
    loop : bool
        Whether to start over at the end.
    speed : float
        Playback speed; 1 is the original one.

    Attributes
    ----------
    pace : Clock
        The clock, shared by all sources; may be replaced before the first `read`.
    """

    pace = Clock()

    def __init__(self, name: str, *, loop: bool = False, speed: float = 1.0) -> None:
        if not 0.01 <= speed <= 100.0:
            raise SourceError(
                "The speed must be between 0.01 and 100; got {speed:g}. Use 1 for the original speed.", speed=speed
            )
        self.name = name
        self._loop, self._speed = loop, speed
        self._closed = threading.Event()
        self._frames: Iterator[LiveFrame] | None = None
        self._next: LiveFrame | None = None
        self._began = 0.0
        self._offset = 0.0

    @abstractmethod
    def frames(self) -> Iterator[LiveFrame]:
        """Iterate over all frames. The time of the first one is 0."""

    def read(self, timeout: float) -> LiveFrame | None:
        """Return the newest frame that is due. See `LiveSource.read`."""
        if self._frames is None and not self.ended:
            self._start()
        if self._next is None or not self._wait(timeout):
            return None
        now, shown, dropped = self.pace.now(), self._next, -1
        # Frames later than the limit set the clock back; otherwise skip to the newest frame that is due.
        self._began += max(0.0, now - self._due(shown) - _LATEST)
        while self._next is not None and self._due(self._next) <= now:
            shown, dropped = self._next, dropped + 1
            self._advance()
            if (late := self.pace.now()) - now > _CATCHING_UP:
                self._began = late - shown.time / self._speed
                break
        return replace(shown, taken=perf_counter(), dropped=dropped)

    def close(self) -> None:
        """Stop, so that a waiting `read` returns None."""
        self._closed.set()

    def _start(self) -> None:
        self._frames = self._repeated()
        self._advance()
        if self._next is not None:
            self._began = self.pace.now() - self._next.time / self._speed

    def _repeated(self) -> Iterator[LiveFrame]:
        """Yield the frames, again and again if they loop, with increasing times."""
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
        """Wait for the next frame; return whether it was due within `timeout` and the source is not closed."""
        assert self._next is not None
        came = self.pace.wait_until(self._due(self._next), timeout, self._closed)
        return came and not self._closed.is_set()


class VideoPlayer(PacedSource):
    """Plays a video file."""

    def __init__(self, path: Path, *, loop: bool = False, speed: float = 1.0) -> None:
        super().__init__(Path(path).name, loop=loop, speed=speed)
        self._path = Path(path)

    def frames(self) -> Iterator[LiveFrame]:
        """Iterate over all frames of the file."""
        with VideoSource(self._path) as source:
            for frame in source:
                yield LiveFrame(frame.time, frame.image)


class PicturePlayer(PacedSource):
    """Plays the images in a folder, sorted by name, at `rate` frames per second."""

    def __init__(self, folder: Path, *, rate: float = PICTURE_RATE, loop: bool = False, speed: float = 1.0) -> None:
        super().__init__(Path(folder).name, loop=loop, speed=speed)
        self._folder, self._rate = Path(folder), rate

    def frames(self) -> Iterator[LiveFrame]:
        """Iterate over the images in the folder; those that cannot be read are skipped."""
        with PictureSource(self._folder, self._rate) as source:
            for frame in source:
                yield LiveFrame(frame.time, frame.image)


class TakePlayer(PacedSource):
    """Plays a take: results of the tracker, without images."""

    def __init__(self, take: Take, name: str, *, loop: bool = False, speed: float = 1.0) -> None:
        super().__init__(name, loop=loop, speed=speed)
        self.complete, self._take = True, take
        width, height = take.info.get("image_size", (0, 0))
        self._size = (int(width), int(height)) if width and height else None
        measured = take.info.get("measured") and take.found.any()
        self._neutral = calibrate(take) if measured else None

    def frames(self) -> Iterator[LiveFrame]:
        """Iterate over all frames of the take."""
        for index, time in enumerate((self._take.times - self._take.times[0]).tolist()):
            yield LiveFrame(time, None, self._take.result(index), neutral=self._neutral, size=self._size)
