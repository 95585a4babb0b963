"""From a video to a take: the frames of a source through a tracker, in order, each with the media's own time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from ..capture import VideoSource
from ..tracking.result import TrackResult
from ..tracking.tracker import FaceTracker
from .file import TakeWriter
from .take import TakeRecorder, describe

OnFrame = Callable[[int, int, TrackResult], bool | None]


def track_video(
    path: Path,
    tracker: FaceTracker,
    on_frame: OnFrame | None = None,
    output: Path | None = None,
    face: tuple[float, float] | None = None,
) -> TakeRecorder:
    """Track every frame of the video at `path`.

    Parameters
    ----------
    on_frame : callable, optional
        Called after each frame with (frames done, frames stated by the file, result); returning False stops.
    output : Path, optional
        A take that is written while tracking, so that whatever happens what was tracked is there; must not exist yet.
    face : (float, float), optional
        Place of the face to follow, as for `FaceTracker.choose`; the largest otherwise.

    Returns
    -------
    TakeRecorder
        Its `finish` gives the take. On KeyboardInterrupt tracking ends early and what was tracked is kept, with
        `info["interrupted"]` set.

    Raises
    ------
    SourceError
        Where the video cannot be read.
    OutputError
        Where `output` cannot be written.
    """
    with ExitStack() as stack:
        source = stack.enter_context(VideoSource(path))
        recorder = TakeRecorder({})
        writer = None if output is None else stack.enter_context(TakeWriter(output, {}))
        tracker.reset()
        if face is not None:
            tracker.choose(*face)
        try:
            for frame in source:
                if len(recorder) == 0:
                    height, width = frame.image.shape[:2]
                    recorder.info.update(describe(source.path.name, source.fps, (width, height), tracker.model_id))
                    if writer is not None:
                        writer.info = recorder.info
                result = tracker.track(frame.image)
                recorder.append(frame.time, result)
                if writer is not None:
                    writer.append(frame.time, result)
                if on_frame is not None and on_frame(len(recorder), source.frame_count, result) is False:
                    recorder.info["interrupted"] = True
                    break
        except KeyboardInterrupt:
            recorder.info["interrupted"] = True
        return recorder
