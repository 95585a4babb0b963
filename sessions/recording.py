"""Recording of takes while a puppet is running: written to disk continuously, added to the list at the end."""

from __future__ import annotations

import contextlib

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.errors import OutputError
from ..core.live.reference_video import SUFFIX as VIDEO_SUFFIX
from ..core.live.reference_video import ReferenceVideo
from ..core.live.worker import LiveWorker
from ..core.takes.file import TakeWriter
from ..core.takes.take import describe
from ..core.tracking.result import TrackResult
from ..settings.preferences import preferences
from ..settings.takes_store import add, new_path


class Recording:
    """Recorder of everything that is tracked. The first frame is at 0 s, and `offset` is its time in the source.

    If a video is kept beside the take, that becomes the source of the take.

    Parameters
    ----------
    worker : LiveWorker
        Records from now on.
    scene : bpy.types.Scene
        The take is added to its list; it also says whether to keep a video.
    name : str
        Base of the file name.

    Raises
    ------
    OutputError
        If the file cannot be created.
    """

    def __init__(self, worker: LiveWorker, scene: bpy.types.Scene, name: str) -> None:
        self.path, self.frames, self.closed = new_path(name), 0, False
        self._worker, self._scene = worker, scene.name
        self._offset, self._last = 0.0, 0.0
        self._video: ReferenceVideo | None = None
        self._writer = TakeWriter(self.path, self._info())
        if scene.facemime_takes.video:
            self._video = ReferenceVideo(self.path.with_suffix(VIDEO_SUFFIX), preferences().rate)
            self._writer.info = self._info()
        worker.record(self)

    @property
    def seconds(self) -> float:
        """Duration so far."""
        return self._last

    def append(self, time: float, result: TrackResult, image: NDArray[np.uint8] | None) -> None:
        """Add a frame. Called in the worker's thread, as are `flush` and `close`.

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
        """Stop recording; OutputError if the end cannot be written. Called in Blender's main thread."""
        if not self.closed:
            self._worker.stop_recording()

    @property
    def length(self) -> float:
        """Duration so far, seconds."""
        return self._last

    @property
    def running(self) -> bool:
        """Whether frames can still be added."""
        return not self.closed and self._worker.recording_error is None

    def add_to_list(self) -> bool:
        """Add a recording that has ended to the list, and return whether there is a file to be added.

        Raises
        ------
        SourceError
            If the file cannot be read.
        """
        if not self.closed:
            with contextlib.suppress(OutputError):  # already reported by the session
                self.close()
        scene = bpy.data.scenes.get(self._scene)
        if scene is None or not self.path.is_file():
            return False
        add(scene, self.path)
        return True

    def _info(self) -> dict:
        worker, source = self._worker, self._worker.source
        fps = (self.frames - 1) / self._last if self._last > 0.0 else 30.0
        width, height = worker.image_size
        size = (width or 640, height or 480)
        info = describe(source.name, fps, size, worker.model, source.clock) | {"offset": self._offset}
        if worker.neutral is not None:
            info["calibration"] = worker.neutral.to_dict()
            if worker.neutral.measured:
                info["measured"] = True
        if self._video is not None and (not self.closed or self._video.written):
            info |= {"source": self._video.path.name, "offset": 0.0, "seen_by": source.name}
        return info
