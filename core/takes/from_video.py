"""From videos to takes: tracking of all frames, in order, with their presentation times."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from os import PathLike
from pathlib import Path

from ..errors import Message
from ..files.capture import VideoSource
from ..files.media_headers import last_image
from ..tracking.result import TrackResult
from ..tracking.tracker import FaceTracker
from .file import TakeWriter
from .take import Take, TakeRecorder, describe

OnFrame = Callable[[int, int, TrackResult], bool | None]
_COMPLETE = 0.9
"""Share of the stated frames, or of the stated duration, from which on a video is complete: headers are inexact."""
VIDEO_CUT = "The video was cut or damaged. Missing: {missing}."
"""Template of what is noted in a take whose video ends too soon."""


def track_video(
    path: str | PathLike[str],
    tracker: FaceTracker | None = None,
    on_frame: OnFrame | None = None,
    output: Path | None = None,
    face: tuple[float, float] | None = None,
) -> Take:
    """Track every frame of a video.

    Parameters
    ----------
    path : path-like
        The video.
    tracker : FaceTracker, optional
        The tracker, which is reset at the start; by default a new one with the shipped model.
    on_frame : callable, optional
        Called after each frame with the number of frames done, the number stated by the file, and the result. Returning
        False stops.
    output : Path, optional
        A take to write while tracking, so that a crash loses nothing; it must not exist.
    face : (float, float), optional
        Position of the face to track, as for `FaceTracker.choose`; by default the largest.

    Returns
    -------
    Take
        The take. A KeyboardInterrupt ends tracking early; what was tracked is kept, and ``info["interrupted"]`` is set.
        If the video ends before its header says, ``info["recovered"]`` says so in a sentence.

    Raises
    ------
    SourceError
        If the video cannot be read, or not even one frame was tracked.
    OutputError
        If `output` cannot be written.

    Examples
    --------
    >>> from facemime import track_video
    >>> take = track_video("clip.mp4")
    >>> take.landmarks.shape, bool(take.found.all())
    ((255, 66, 2), True)
    """
    tracker = FaceTracker.load() if tracker is None else tracker
    with ExitStack() as stack:
        source = stack.enter_context(VideoSource(Path(path)))
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
            else:
                if (lost := _lost_after(source, len(recorder), frame.time)) > 0.0:
                    missing = f"{lost:.2f} s after {frame.time:.2f} s"
                    recorder.info["recovered"] = Message(VIDEO_CUT, missing=missing)
        except KeyboardInterrupt:
            if len(recorder) == 0:
                raise
            recorder.info["interrupted"] = True
        return recorder.finish()


def _lost_after(source: VideoSource, count: int, last: float) -> float:
    """Return how many seconds of a video are missing after the last image that was read; 0 if it is complete.

    Parameters
    ----------
    last : float
        Time of the last one.
    """
    stated = source.frame_count / source.fps
    if count >= _COMPLETE * source.frame_count or last >= _COMPLETE * stated:
        return 0.0
    # Some files state only how long they last, which may be how long their sound does.
    images = last_image(source.path)
    stated = stated if images is None else images
    return max(0.0, stated - last) if last < _COMPLETE * stated else 0.0
