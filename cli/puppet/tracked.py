"""Tracking of a video from the command line, with progress, keeping what was tracked if it is interrupted."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from ...core.errors import FacemimeError, Message, SourceError
from ...core.files.writing import free_name, settle
from ...core.media.capture import require_file
from ...core.takes.file import SUFFIX, load_take
from ...core.takes.from_video import track_video
from ...core.takes.take import Take
from ...core.tracking.result import TrackResult
from ...core.tracking.tracker import FaceTracker
from ...core.tracking.tracking_settings import DEFAULTS, TrackingSettings
from ..terminal.console import Progress, tell
from ..terminal.stopping import INTERRUPTED, STOPPING
from ..terminal.takes import tell_what_is_missing

INTERRUPTED_NAME = ".interrupted"
_UNFINISHED = f".unfinished{SUFFIX}"


def unfinished_beside(output: Path) -> Path:
    """File for the unfinished take of `output`."""
    return output.with_suffix(_UNFINISHED)


def place_beside(output: Path, suffix: str) -> Path:
    """File for the result of an interrupted run: `output` if it does not exist, otherwise a free name beside it.

    Parameters
    ----------
    output : Path
        The file that was asked for.
    suffix : str
        Suffix of the result.
    """
    if not os.path.lexists(output):
        return output
    return free_name(output.with_suffix(f"{INTERRUPTED_NAME}{suffix}"))


@contextlib.contextmanager
def growing(unfinished: Path) -> Iterator[Path]:
    """Yield a free name for an unfinished take; if what follows fails, the error names that file.

    An unfinished take of an earlier run is kept, with a message.
    """
    name = free_name(unfinished)
    if name != unfinished:
        tell(f"facemime: {unfinished} is from an earlier run that did not finish; it is kept.")
    try:
        yield name
    except FacemimeError as error:
        if str(name) in str(error) or not name.exists():
            raise
        raise type(error)(Message("{error} What was tracked is in {name}.", error=error, name=name)) from error
    except KeyboardInterrupt as stop:
        if not name.exists():
            raise
        raise KeyboardInterrupt(Message("what was tracked is in {name}", name=name)) from stop


def track(
    video: Path, unfinished: Path, face: tuple[float, float] | None, settings: TrackingSettings = DEFAULTS
) -> Take:
    """Track `video`, writing the take to `unfinished` at the same time.

    Parameters
    ----------
    unfinished : Path
        File that grows while tracking.
    face : (float, float) or None
        As for `FaceTracker.choose`.

    Raises
    ------
    SourceError
        If the video cannot be read, or no face was found in it.
    """
    require_file(video)
    tracker = FaceTracker.load(settings=settings)
    progress = Progress(f"Tracking {video.name}")

    def on_frame(done: int, total: int, _: TrackResult) -> bool:
        progress.update(done, total)
        return not STOPPING.heard

    with STOPPING.noting():
        track_video(video, tracker, on_frame, unfinished, face)
    take = load_take(unfinished)
    progress.finish(f"a face in {int(take.found.sum())} of {len(take)}")
    tell_what_is_missing(video, take)
    if not take.found.any() and not take.info.get("interrupted"):
        unfinished.unlink()
        raise SourceError(
            "No face was found in any frame of {video}. Use a video with one face, well lit and towards the camera.",
            video=video,
        )
    return take


def keep_interrupted(take: Take, unfinished: Path, kept: Path) -> int:
    """Move the take of an interrupted run to `kept`, with a message; returns the exit status.

    Parameters
    ----------
    unfinished : Path
        The file that grew.
    kept : Path
        The file to keep.
    """
    settle(unfinished, kept)
    tell(f"facemime: interrupted; the {len(take)} frames tracked are in {kept}.")
    return INTERRUPTED
