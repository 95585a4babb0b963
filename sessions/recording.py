"""Recording of takes while a puppet is running: written to disk continuously, added to the list at the end."""

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
    """Recorder for `LiveSession.record`. The first frame is at 0 s, and `offset` is its time in the source.

    If a video is kept beside the take, that becomes the source of the take.

    Parameters
    ----------
    session : LiveSession
    path : Path
        File of the take; must not exist yet.
    scene : str
        Name of the scene to whose list the take is added.
    video_fps : float, optional
        Frame rate of a video to keep beside the take; by default none is kept.

    Raises
    ------
    OutputError
        If the file cannot be created.
    """

    current = None
    """The running instance, or one that has ended and is not in the list yet."""

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
        """Add a frame. Called in the worker's thread, like everything but `stop`.

        Parameters
        ----------
        time : float
            Time in the source, seconds.
        result : TrackResult
        image : (H, W, 3) uint8 BGR, or None
            For the video.
        """
        if not self.frames:
            self._offset = time
        self._last = time - self._offset
        self._writer.append(self._last, result)
        self.frames += 1
        if self._video is not None and image is not None:
            self._video.add(self._last, image)

    def flush(self) -> None:
        """Write all frames so far to disk."""
        self._writer.flush()

    def close(self) -> None:
        """Finish the file."""
        self.closed = True
        if self._video is not None:
            self._video.close()
        self._writer.info = self._info()
        self._writer.close()

    @property
    def video_failed(self) -> bool:
        """Whether a video was requested but could not be written."""
        return self.closed and self._video is not None and not self._video.written

    def stop(self) -> None:
        """Stop recording; called in Blender's main thread."""
        if not self.closed:
            self._session.worker.stop_recording()

    @property
    def length(self) -> float:
        """Duration so far, seconds."""
        return self._last

    @property
    def running(self) -> bool:
        """Whether frames can still be added."""
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
    """Start recording a session.

    Parameters
    ----------
    session : LiveSession or None
    scene : bpy.types.Scene
        The take is added to its list; it also says whether to keep a video.
    name : str
        Base of the file name.

    Raises
    ------
    HeadError
        If there is no session.
    OutputError
        If the file cannot be created.
    """
    if session is None:
        raise HeadError("No puppet is running. Start it before recording.")
    video = preferences().rate if scene.facemime_takes.video else None
    return Recording(session, new_path(name), scene.name, video)


def stop_recording() -> None:
    """Stop the running recording, but not its session; raises OutputError if its end cannot be written."""
    if Recording.current is not None:
        Recording.current.stop()


def settle() -> bool:
    """Add a recording that has ended to the list, and return whether there was one."""
    recording = Recording.current
    if recording is None or recording.running:
        return False
    Recording.current = None
    if not recording.closed:
        with contextlib.suppress(OutputError):  # already reported by the session
            recording.close()
    scene = bpy.data.scenes.get(recording.scene)
    if scene is None or not recording.path.is_file():
        return False
    add(scene, recording.path)
    return True
