"""A take that is recorded while a puppet runs; on the disk frame by frame, in the list when it ends."""

from __future__ import annotations

import contextlib
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.errors import HeadError, OutputError
from ..core.live.reference_video import SUFFIX as VIDEO_SUFFIX
from ..core.live.reference_video import ReferenceVideo
from ..core.takes.file import TakeWriter
from ..core.takes.take import describe
from ..core.tracking.result import TrackResult
from ..settings.preferences import preferences
from ..settings.takes_store import add, new_path
from .live import LiveSession


class Recording:
    """What `LiveSession.record` takes: a file whose first frame is at 0 s; `offset` says when that was in the source.

    With a video beside it, that is the source from then on.

    Parameters
    ----------
    session : LiveSession
    path : Path
        Must not exist yet.
    scene : str
        Name of the one in whose list it comes.
    video_fps : float, optional
        Rate of a video of what is seen, which is written beside the take; without it none is.

    Raises
    ------
    OutputError
        Where the file cannot be made.
    """

    current = None
    """The one that runs, or has ended and is not in the list yet."""

    def __init__(self, session: LiveSession, path: Path, scene: str, video_fps: float | None = None) -> None:
        self.path, self.frames, self.closed, self.scene = path, 0, False, scene
        self._session, self._offset, self._last = session, 0.0, 0.0
        self._video: ReferenceVideo | None = None
        self._writer = TakeWriter(path, self._info())
        if video_fps is not None:
            self._video = ReferenceVideo(path.with_suffix(VIDEO_SUFFIX), video_fps)
            self._writer.info = self._info()
        session.record(self)
        Recording.current = self

    def append(self, time: float, result: TrackResult, image: NDArray[np.uint8] | None) -> None:
        """Take in a frame; in the worker's thread, as all but `stop`."""
        if not self.frames:
            self._offset = time
        self._last = time - self._offset
        self._writer.append(self._last, result)
        self.frames += 1
        if self._video is not None and image is not None:
            self._video.add(self._last, image)

    def flush(self) -> None:
        """Bring what came so far onto the disk."""
        self._writer.flush()

    def close(self) -> None:
        """End the file."""
        self.closed = True
        if self._video is not None:
            self._video.close()
        self._writer.info = self._info()
        self._writer.close()

    @property
    def video_failed(self) -> bool:
        """Whether a video was asked for and is not there."""
        return self.closed and self._video is not None and not self._video.written

    def stop(self) -> None:
        """End it; from Blender's thread."""
        if not self.closed:
            self._session.worker.stop_recording()

    @property
    def length(self) -> float:
        """Seconds so far."""
        return self._last

    @property
    def running(self) -> bool:
        """Whether frames may still come."""
        return not self.closed and self._session.worker.recording_error is None

    def _info(self) -> dict:
        worker = self._session.worker
        source = worker.source
        fps = (self.frames - 1) / self._last if self._last > 0.0 else 30.0
        width, height = worker.image_size
        size = (width or 640, height or 480)
        info = describe(source.name, fps, size, worker.model, source.clock) | {"offset": self._offset}
        if worker.neutral is not None:
            info["calibration"] = worker.neutral.to_dict()
        if self._video is not None and (not self.closed or self._video.written):
            info |= {"source": self._video.path.name, "offset": 0.0, "seen_by": source.name}
        return info


def start_recording(session: LiveSession | None, scene: bpy.types.Scene, name: str) -> Recording:
    """Record what `session` tracks from now on, with a video where the scene asks for it; HeadError where none runs."""
    if session is None:
        raise HeadError("Nothing is running that could be recorded. Start the puppet first.")
    video = preferences().rate if scene.facemime_takes.video else None
    return Recording(session, new_path(name), scene.name, video)


def stop_recording() -> None:
    """End the recording that runs; the session goes on. OutputError where its end cannot be written."""
    if Recording.current is not None:
        Recording.current.stop()


def settle() -> bool:
    """List what was recorded, once its recording has ended; whether there was something."""
    recording = Recording.current
    if recording is None or recording.running:
        return False
    Recording.current = None
    if not recording.closed:
        with contextlib.suppress(OutputError):  # the session has told it already
            recording.close()
    scene = bpy.data.scenes.get(recording.scene)
    if scene is None or not recording.path.is_file():
        return False
    add(scene, recording.path)
    return True
