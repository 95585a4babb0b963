"""Tracking a video from the command line: with progress, and with what was tracked kept whatever ends it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from ...core.capture import require_file
from ...core.errors import FacemimeError, SourceError
from ...core.files import free_name, settle
from ...core.takes.file import SUFFIX, load_take
from ...core.takes.from_video import track_video
from ...core.takes.take import Take
from ...core.tracking.result import TrackResult
from ...core.tracking.tracker import FaceTracker
from ..terminal.console import Progress, tell
from ..terminal.stopping import INTERRUPTED, STOPPING

INTERRUPTED_NAME = ".interrupted"
_UNFINISHED = f".unfinished{SUFFIX}"


def unfinished_beside(output: Path) -> Path:
    """Where a take grows that belongs to `output`."""
    return output.with_suffix(_UNFINISHED)


def place_beside(output: Path, suffix: str) -> Path:
    """Where the part of an interrupted run goes: `output` where nothing is there yet, a free name beside it else."""
    if not os.path.lexists(output):
        return output
    return free_name(output.with_suffix(f"{INTERRUPTED_NAME}{suffix}"))


@contextlib.contextmanager
def growing(unfinished: Path) -> Iterator[Path]:
    """A free name for a take that is tracked; where what follows fails, the error says that the take is there.

    An earlier run's unfinished take is kept, which is said.
    """
    name = free_name(unfinished)
    if name != unfinished:
        tell(f"facemime: {unfinished} is what an earlier run tracked before it was broken off; it is kept.")
    try:
        yield name
    except FacemimeError as error:
        if str(name) in str(error) or not name.exists():
            raise
        raise type(error)(f"{error} What was tracked is in {name}.") from error
    except KeyboardInterrupt as stop:
        if not name.exists():
            raise
        raise KeyboardInterrupt(f"what was tracked is in {name}") from stop


def track(video: Path, unfinished: Path, face: tuple[float, float] | None) -> Take:
    """The take of `video`, written to `unfinished` as it grows.

    Raises
    ------
    SourceError
        Where the video cannot be read, or no face was found in it.
    """
    require_file(video)
    tracker = FaceTracker.load()
    progress = Progress(f"Tracking {video.name}")

    def on_frame(done: int, total: int, _: TrackResult) -> bool:
        progress.update(done, total)
        return not STOPPING.heard

    with STOPPING.noting():
        track_video(video, tracker, on_frame, unfinished, face)
    if not unfinished.exists():
        raise KeyboardInterrupt("no frame was tracked yet")
    take = load_take(unfinished)
    progress.finish(f"a face in {int(take.found.sum())} of {len(take)}")
    if not take.found.any() and not take.info.get("interrupted"):
        unfinished.unlink()
        raise SourceError(
            f"No face was found in any frame of {video}. Use a video with one face, well lit and towards the camera."
        )
    return take


def keep_interrupted(take: Take, unfinished: Path, kept: Path) -> int:
    """Give what was tracked until Ctrl-C its name, and say so; returns the exit status."""
    settle(unfinished, kept)
    tell(f"facemime: interrupted; the {len(take)} frames tracked are in {kept}.")
    return INTERRUPTED
