"""Tracking of a whole video in a thread."""

from __future__ import annotations

import threading
from pathlib import Path

from ..core.errors import FacemimeError
from ..core.takes.from_video import track_video
from ..core.takes.take import Take
from ..core.tracking.result import TrackResult
from ..core.tracking.tracker import DEFAULTS, FaceTracker, TrackingSettings
from .session import Session

_JOIN_TIMEOUT = 10.0
"""Seconds to wait for the thread, which may be in the middle of a frame."""


class TrackingSession(Session):
    """Tracks a video in a thread; `close` stops it at any time and keeps the frames so far.

    The face is as for `track_video`. `done` and `total` are the frames tracked, and those in the video according to its
    header.
    """

    def __init__(
        self, video: Path, face: tuple[float, float] | None = None, settings: TrackingSettings = DEFAULTS
    ) -> None:
        super().__init__()
        self.video, self._face, self._settings = Path(video), face, settings
        self.done, self.total = 0, 0
        self._stopping = threading.Event()
        self._take: Take | None = None
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="facemime-tracking", daemon=True)
        self._thread.start()

    @property
    def tracking(self) -> bool:
        """Whether the thread is still tracking."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Ask the thread to stop after the current frame."""
        self._stopping.set()

    def take(self) -> Take:
        """Wait for the thread and return the take.

        Raises FacemimeError if tracking failed, or was stopped before the first frame.
        """
        self._thread.join()
        if self._error is not None:
            raise self._error
        if self._take is None:
            raise FacemimeError("Tracking was stopped before the first frame. Start it again.")
        return self._take

    def _stop(self) -> None:
        """Stop the thread and wait a limited time for it; a thread that hangs is abandoned."""
        self.stop()
        self._thread.join(_JOIN_TIMEOUT)

    def _work(self) -> None:
        try:
            tracker = FaceTracker.load(settings=self._settings)
            self._take = track_video(self.video, tracker, self._on_frame, face=self._face)
        except Exception as error:  # raised again by `take`
            self._error = error

    def _on_frame(self, done: int, total: int, result: TrackResult) -> bool:
        self.done, self.total = done, total
        return not self._stopping.is_set()
