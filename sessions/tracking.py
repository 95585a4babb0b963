"""A whole video tracked in a thread, beside Blender."""

from __future__ import annotations

import threading
from pathlib import Path

from ..core.errors import FacemimeError
from ..core.takes.from_video import track_video
from ..core.takes.take import Take, TakeRecorder
from ..core.tracking.result import TrackResult
from ..core.tracking.tracker import FaceTracker
from .session import Session

_ENDING = 10.0
"""Seconds to wait for the thread, which may be in the middle of a frame."""


class TrackingSession(Session):
    """Tracks a video in a thread of its own; `close` ends it at any time and keeps what was tracked.

    Parameters
    ----------
    video : Path
    face : (float, float), optional
        As for `track_video`.

    Attributes
    ----------
    done, total : int
        Frames tracked, and frames stated by the file.
    """

    def __init__(self, video: Path, face: tuple[float, float] | None = None) -> None:
        super().__init__()
        self.video, self._face = Path(video), face
        self.done, self.total = 0, 0
        self._stop = threading.Event()
        self._recorder: TakeRecorder | None = None
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="facemime-tracking", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the worker is still at it."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Ask the worker to end after the frame in hand."""
        self._stop.set()

    def take(self) -> Take:
        """Wait for the worker and return what it tracked.

        Raises
        ------
        FacemimeError
            What the worker met.
        """
        self._thread.join()
        if self._error is not None:
            raise self._error
        if self._recorder is None:
            raise FacemimeError("Tracking was stopped before the first frame. Start it again.")
        return self._recorder.finish()

    def close(self, *, blocks: bool = True) -> None:
        """End the worker, and wait for it as long as a frame may take; one that hangs ends by itself when it can."""
        self.stop()
        self._thread.join(_ENDING)
        super().close()

    def _work(self) -> None:
        try:
            self._recorder = track_video(self.video, FaceTracker.load(), self._on_frame, face=self._face)
        except Exception as error:  # handed over to the thread that asks for the take
            self._error = error

    def _on_frame(self, done: int, total: int, result: TrackResult) -> bool:
        self.done, self.total = done, total
        return not self._stop.is_set()
