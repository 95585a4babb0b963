"""Recording of takes while a puppet is running: written to disk continuously, added to the list at the end."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..blender.contexts import find_scene
from ..core.errors import OutputError
from ..core.puppet.reference_video import SUFFIX as VIDEO_SUFFIX
from ..core.puppet.reference_video import ReferenceVideo
from ..core.puppet.sources import LiveFrame, PacedSource
from ..core.puppet.worker import LiveWorker
from ..core.takes.file import SUFFIX, TakeWriter
from ..core.takes.take import describe
from ..core.tracking.result import TrackResult
from ..settings.preferences import preferences
from ..settings.storage import beside, free_path
from ..settings.takes_store import add, new_path


@dataclass
class _Part:
    """A take that is being recorded."""

    path: Path
    writer: TakeWriter
    performer: int | None = None
    sender: str = ""
    frames: int = 0
    last: float = 0.0


class Recording:
    """Recorder of everything that is tracked, `offset` seconds after the times of the source.

    If several performers drive heads, each has a take over the same period, named after its heads; that of the first
    head comes first, and is the one to which `path` and `seconds` refer. The takes are added to the list of the scene,
    which also says whether to keep a video with them. If so, it becomes the source of the take. `name` is the base of
    the file names. Raises OutputError if the file cannot be created.
    """

    def __init__(self, worker: LiveWorker, scene: bpy.types.Scene, name: str, heads: Sequence[str] = ()) -> None:
        self.path, self.closed = new_path(name), False
        self._worker, self._scene, self._name, self._heads = worker, scene.session_uid, name, tuple(heads)
        self._dropped = worker.counts.dropped
        self._offset: float | None = None
        self._video: ReferenceVideo | None = None
        self._main = _Part(self.path, TakeWriter(self.path, {}))
        self._main.writer.info = self._info(self._main)
        self._others: dict[int, _Part] = {}
        if scene.facemime_takes.video:
            self._video = ReferenceVideo(self.path.with_suffix(VIDEO_SUFFIX), preferences().rate)
            self._main.writer.info = self._info(self._main)
        worker.record(self)

    @property
    def seconds(self) -> float:
        """Duration so far."""
        return self._main.last

    @property
    def frames(self) -> int:
        """Frames so far."""
        return self._main.frames

    @property
    def dropped(self) -> int:
        """Frames of a video that were skipped since the start, as tracking could not keep up with it."""
        played = isinstance(self._worker.source, PacedSource)
        return self._worker.counts.dropped - self._dropped if played else 0

    @property
    def takes(self) -> int:
        """Number of takes that are recorded."""
        return len(self._parts())

    def append(self, frame: LiveFrame, result: TrackResult) -> None:
        """Add a frame. Called in the worker's thread, as are `flush` and `close`."""
        self._offset = frame.time if self._offset is None else self._offset
        part, time = self._part_of(frame), frame.time - self._offset
        if time < 0.0:
            return
        part.performer, part.sender, part.last = frame.performer, frame.sender, time
        part.writer.append(time, result)
        part.frames += 1
        if self._video is not None and frame.image is not None:
            self._video.add(time, frame.image)

    def flush(self) -> None:
        """Write all frames so far to disk."""
        for part in self._parts():
            part.writer.flush()

    def close(self) -> None:
        """Finish the files."""
        self.closed = True
        if self._video is not None:
            self._video.close()
        for part in self._parts():
            part.writer.info = self._info(part)
            part.writer.close()

    @property
    def video_failed(self) -> bool:
        """Whether a video was requested but could not be written."""
        return self.closed and self._video is not None and not self._video.written

    def stop(self) -> None:
        """Stop recording; OutputError if the end cannot be written. Called in Blender's main thread."""
        if not self.closed:
            self._worker.stop_recording()

    @property
    def running(self) -> bool:
        """Whether frames can still be added."""
        return not self.closed and self._worker.recording_error is None

    def add_to_list(self) -> list[tuple[int, Path]]:
        """Add a recording that has ended to the list.

        Returns the `session_uid` of the scene and the file of each take that was added. Raises SourceError if the file
        cannot be read.
        """
        if not self.closed:
            with contextlib.suppress(OutputError):  # already reported by the session
                self.close()
        scene = find_scene(self._scene)
        if scene is None:
            return []
        there = [part for part in reversed(self._parts()) if part.path.is_file()]
        if any(part.frames for part in there):
            there = [part for part in there if part.frames]
        for part in there:
            add(scene, beside(part.path))
        return [(scene.session_uid, part.path) for part in there]

    def _parts(self) -> list[_Part]:
        return [self._main, *tuple(self._others.values())]

    def _part_of(self, frame: LiveFrame) -> _Part:
        """The take to which a frame belongs: another one for each performer."""
        first = frame.heads is None or 0 in frame.heads
        if self._main.performer == frame.performer or (self._main.performer is None and first):
            return self._main
        if (part := self._others.get(frame.performer)) is None:
            heads = [self._heads[head] for head in frame.heads or () if head < len(self._heads)]
            path = free_path(self.path.parent, " ".join([self._name, *heads[:1]]), SUFFIX)
            part = _Part(path, TakeWriter(path, {}), frame.performer, frame.sender)
            part.writer.info = self._info(part)
            self._others[frame.performer] = part
        return part

    def _info(self, part: _Part) -> dict[str, Any]:
        worker, source = self._worker, self._worker.source
        fps = (part.frames - 1) / part.last if part.last > 0.0 else 30.0
        width, height = worker.image_size
        size = (width or 640, height or 480)
        info = describe(source.name, fps, size, worker.model, source.clock) | {"offset": self._offset or 0.0}
        if part.sender:
            info["sender"] = part.sender
        performer = None if part.performer is None else worker.performer(part.performer)
        neutral = worker.first.neutral if performer is None else performer.neutral
        if neutral is not None:
            info["calibration"] = neutral.to_dict()
            if neutral.measured:
                info["measured"] = True
        if self._video is not None and (not self.closed or self._video.written):
            info |= {"source": self._video.path.name, "offset": 0.0, "seen_by": source.name}
        return info
