"""From videos to takes: tracking of all frames, in order, with their presentation times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any

from ..errors import Message, SourceError
from ..files.capture import PICTURE_RATE, PictureSource, VideoSource, open_video
from ..files.closing import Closing
from ..files.media_headers import last_image
from ..tracking.cuts import CutDetector
from ..tracking.people import PeopleTracker
from ..tracking.result import TrackResult
from ..tracking.rivals import WATCHED
from ..tracking.tracker import FaceTracker
from .file import TakeWriter
from .take import Take, TakeRecorder, describe

OnFrame = Callable[[int, int, TrackResult], bool | None]
OnFaces = Callable[[int, int, int], bool | None]
_LOOKED_AT = 2 * WATCHED
"""Frames in which somebody has to move beside a picture of a face."""
_SHORTEST = 0.5
"""Seconds for which somebody has to be seen to get a take of their own."""
_COMPLETE = 0.9
"""Share of the stated frames, or of the stated duration, from which on a video is complete: headers are inexact."""
VIDEO_CUT = "The video was cut or damaged. Missing: {missing}."
"""Template of what is noted in a take whose video ends too soon."""
PICTURES_SKIPPED = "{count} pictures are missing or damaged. The other ones keep their times."
"""Template of what is noted in a take of pictures of which some were not shown."""


def track_video(
    path: str | PathLike[str],
    tracker: FaceTracker | None = None,
    on_frame: OnFrame | None = None,
    output: Path | None = None,
    face: tuple[float, float] | None = None,
    rate: float = PICTURE_RATE,
) -> Take:
    """Track every frame of a video.

    Parameters
    ----------
    path : path-like
        The video, or a folder with its frames as pictures, or with photographs.
    tracker : FaceTracker, optional
        The tracker, which is reset at the start; by default a new one with the shipped model.
    on_frame : callable, optional
        Called after each frame with the number of frames done, the number stated by the file, and the result. Returning
        False stops.
    output : Path, optional
        A take to write while tracking, so that a crash loses nothing; it must not exist.
    face : (float, float), optional
        Position of the face to track, as for `FaceTracker.choose`; by default the largest, or if that is a picture
        beside a face that moves in the first two seconds, the one that moves.
    rate : float
        Frames per second of pictures.

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
        source = open_video(Path(path), rate)
        stack.enter_context(source)
        recorder = stack.enter_context(_Recorder({}, output))
        tracker.reset()
        first = _performer(tracker, Path(path), rate) if face is None else face
        if first is not None:
            tracker.choose(*first)
        cuts = CutDetector() if isinstance(source, PictureSource) else None
        try:
            for frame in source:
                # Pictures may be unrelated photographs, so that nobody is awaited in the next one.
                if cuts is not None and cuts.is_cut(frame.image):
                    tracker.reset()
                    if face is not None:
                        tracker.choose(*face)
                if len(recorder) == 0:
                    height, width = frame.image.shape[:2]
                    recorder.note(**describe(source.path.name, source.fps, (width, height), tracker.model_id))
                result = tracker.track(frame.image)
                recorder.append(frame.time, result)
                if on_frame is not None and on_frame(len(recorder), source.frame_count, result) is False:
                    recorder.note(interrupted=True)
                    break
            else:
                if missing := _missing(source, len(recorder), frame.time):
                    recorder.note(recovered=missing)
        except KeyboardInterrupt:
            if len(recorder) == 0:
                raise
            recorder.note(interrupted=True)
        return recorder.finish()


def _performer(tracker: FaceTracker, path: Path, rate: float) -> tuple[float, float] | None:
    """Return the place of a face that moves beside a larger picture of one, for `FaceTracker.choose`; None for none."""
    with open_video(path, rate) as source:
        return tracker.performer(frame.image for frame in islice(source, _LOOKED_AT))


def track_people(
    path: str | PathLike[str],
    tracker: FaceTracker | None = None,
    on_frame: OnFaces | None = None,
    output: Path | None = None,
    rate: float = PICTURE_RATE,
) -> list[Take]:
    """Track everybody in a video, or in a folder with its frames as pictures, at `rate` frames per second.

    `on_frame` is called after each frame with the number of frames done, the number stated by the file, and the number
    of faces in view; if it returns False, tracking stops. Where `output` is given, the takes are written while tracking
    to files that must not exist, each person's `numbered`.

    Returns
    -------
    list of Take
        A take of each person who was seen for half a second, in order of appearance; of the longest one if nobody was.
        All have all frames of the video, and no face where the person is out of view.

    Raises
    ------
    SourceError
        If the video cannot be read, or no face was found.
    OutputError
        If a take cannot be written.
    """
    people = PeopleTracker(FaceTracker.load() if tracker is None else tracker)
    with ExitStack() as stack:
        source = open_video(Path(path), rate)
        stack.enter_context(source)
        recorders: list[_Recorder] = []
        times: list[float] = []
        info: dict[str, Any] = {}
        nothing = TrackResult.nothing(people.n_modes)
        try:
            for frame in source:
                if not times:
                    height, width = frame.image.shape[:2]
                    info = describe(source.path.name, source.fps, (width, height), people.model_id)
                results = people.track(frame.image)
                for number in range(len(recorders), max(results, default=-1) + 1):
                    own = None if output is None else numbered(output, number)
                    recorders.append(stack.enter_context(_Recorder({**info, "person": number + 1}, own)))
                    for time in times:
                        recorders[-1].append(time, nothing)
                times.append(frame.time)
                for number, recorder in enumerate(recorders):
                    recorder.append(frame.time, results.get(number, nothing))
                if on_frame is not None and on_frame(len(times), source.frame_count, len(results)) is False:
                    _note(recorders, interrupted=True)
                    break
            else:
                if missing := _missing(source, len(times), frame.time):
                    _note(recorders, recovered=missing)
        except KeyboardInterrupt:
            if not recorders:
                raise
            _note(recorders, interrupted=True)
        if not recorders:
            raise SourceError(
                "No face was found in any frame. Use a video with one face, well lit and towards the camera."
            )
        _note(recorders, people=len(recorders))
        seen = [recorder.seen / source.fps for recorder in recorders]
        return [r.finish() for r, long in zip(recorders, seen, strict=True) if long >= min(_SHORTEST, max(seen))]


def _note(recorders: Sequence[_Recorder], **info: Any) -> None:
    for recorder in recorders:
        recorder.note(**info)


def numbered(path: Path, number: int) -> Path:
    """Name of the take of a person, from 0, beside `path`: `talk-1.facetake`."""
    return path.with_name(f"{path.stem}-{number + 1}{path.suffix}")


class _Recorder(Closing):
    """Records a take, and writes it to a file if it has one; `seen` is the number of frames with a face."""

    def __init__(self, info: dict[str, Any], output: Path | None) -> None:
        self._recorder = TakeRecorder(info)
        self._writer = None if output is None else TakeWriter(output, info)
        self.seen = 0

    def append(self, time: float, result: TrackResult) -> None:
        """Add a frame."""
        self.seen += result.found
        self._recorder.append(time, result)
        if self._writer is not None:
            self._writer.append(time, result)

    def __len__(self) -> int:
        return len(self._recorder)

    def note(self, **info: Any) -> None:
        """Add to the take's description."""
        self._recorder.info.update(info)
        if self._writer is not None:
            self._writer.info.update(info)

    def finish(self) -> Take:
        """Return the take recorded so far; SourceError if there is no frame."""
        return self._recorder.finish()

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()


def _missing(source: VideoSource | PictureSource, count: int, last: float) -> str:
    """Say what is missing of a video of `count` images, the last of which is at `last` seconds; "" if nothing is."""
    if isinstance(source, PictureSource):
        return Message(PICTURES_SKIPPED, count=source.skipped) if source.skipped else ""
    stated = source.frame_count / source.fps
    if count >= _COMPLETE * source.frame_count or last >= _COMPLETE * stated:
        return ""
    # Some files state only how long they last, which may be how long their sound does.
    images = last_image(source.path)
    stated = stated if images is None else images
    return Message(VIDEO_CUT, missing=f"{stated - last:.2f} s after {last:.2f} s") if last < _COMPLETE * stated else ""
