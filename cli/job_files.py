"""Files of a job: takes that are loaded or tracked, outputs, which are claimed, and what needs Blender's module."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from ..core.errors import FacemimeError, Message, SourceError
from ..core.files.capture import PICTURE_RATE, check_readable, require_file
from ..core.files.writing import check_distinct, check_writable, claimed, free_name, settle
from ..core.takes.file import SUFFIX, load_take
from ..core.takes.from_video import numbered, track_people, track_video
from ..core.takes.take import Take
from ..core.tracking.tracker import DEFAULTS, FaceTracker, TrackingSettings
from .console import Progress, tell
from .stopping import INTERRUPTED, STOPPING

INTERRUPTED_NAME = ".interrupted"


def load_with_warnings(path: Path, *, solved: bool = True) -> Take:
    """Load a take, as `load_take`; what is missing is reported on the standard error.

    Raises SourceError if it cannot be read.
    """
    check_readable(path)
    take = load_take(path, solved=solved)
    _tell_what_is_missing(path, take)
    return take


def _tell_what_is_missing(path: Path, take: Take) -> None:
    """Report on the standard error what could not be read of `path`, the file of a take or its video."""
    if lost := take.info.get("recovered"):
        tell(f"facemime: {path}: {lost}")


_UNFINISHED = f".unfinished{SUFFIX}"


def unfinished_beside(output: Path) -> Path:
    """File for the unfinished take of `output`."""
    return output.with_suffix(_UNFINISHED)


def place_beside(output: Path, suffix: str) -> Path:
    """File for the result of an interrupted run: `output` if it does not exist, otherwise a free name beside it."""
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
    video: Path,
    unfinished: Path,
    face: tuple[float, float] | None,
    settings: TrackingSettings = DEFAULTS,
    rate: float = PICTURE_RATE,
) -> Take:
    """Track `video`, or a folder of pictures at `rate` frames per second, and write the take to `unfinished` meanwhile.

    The face is as for `FaceTracker.choose`. Raises SourceError if the video cannot be read, or no face was found in it.
    """
    _require(video)
    tracker = FaceTracker.load(settings=settings)
    progress = Progress(f"Tracking {video.name}")
    with STOPPING.noting():
        track_video(video, tracker, _telling(progress), unfinished, face, rate)
    take = load_take(unfinished)
    progress.finish(f"a face in {int(take.found.sum())} of {len(take)}")
    _tell_what_is_missing(video, take)
    if not take.found.any() and not take.info.get("interrupted"):
        unfinished.unlink()
        raise SourceError(
            "No face was found in any frame of {video}. Use a video with one face, well lit and towards the camera.",
            video=video,
        )
    return take


def track_everybody(video: Path, unfinished: Path, settings: TrackingSettings, rate: float) -> list[tuple[Path, Take]]:
    """Track everybody in `video`, or in a folder of pictures at `rate` frames per second, and write takes meanwhile.

    The files that grow have numbered names like `unfinished`. Returns them with the takes; those of people who were
    hardly seen are deleted. Raises SourceError if the video cannot be read, or no face was found in it.
    """
    _require(video)
    tracker = FaceTracker.load(settings=settings)
    progress = Progress(f"Tracking {video.name}")
    if (earlier := numbered(unfinished, 0)).exists():
        tell(f"facemime: {earlier} is from an earlier run that did not finish; it is kept.")
        unfinished = next(
            name
            for number in count(2)
            if not numbered(name := unfinished.with_stem(f"{unfinished.stem}-{number}"), 0).exists()
        )
    with STOPPING.noting():
        takes = track_people(video, tracker, _telling(progress), unfinished, rate)
    named = [(numbered(unfinished, take.info["person"] - 1), take) for take in takes]
    kept = {path for path, _ in named}
    for number in range(max(take.info["people"] for take in takes)):
        if (path := numbered(unfinished, number)) not in kept:
            path.unlink()
    progress.finish(f"{len(takes)} people" if len(takes) != 1 else "1 person")
    _tell_what_is_missing(video, takes[0])
    return named


def _require(video: Path) -> None:
    """Raise a SourceError unless there is a video or a folder of that name."""
    if not os.path.isdir(video):
        require_file(video)


def _telling(progress: Progress) -> Callable[[int, int, object], bool]:
    """What shows the progress after each frame, and says whether to go on."""

    def on_frame(done: int, total: int, _: object) -> bool:
        progress.update(done, total)
        return not STOPPING.heard

    return on_frame


def keep_interrupted(take: Take, unfinished: Path, kept: Path) -> int:
    """Move the take of an interrupted run from `unfinished` to `kept`, with a message; returns the exit status."""
    settle(unfinished, kept)
    tell(f"facemime: interrupted; the {len(take)} frames tracked are in {kept}.")
    return INTERRUPTED


Outputs = Sequence[tuple[Path | None, Collection[str]]]


@contextlib.contextmanager
def outputs_of(outputs: Outputs, inputs: Mapping[str, Path | None], *more: Path) -> Iterator[None]:
    """Check the outputs of a command, which users named, by their allowed suffixes, and claim them for this process.

    They must not be one of the inputs, which are given by their description. Raises OutputError if an output cannot be
    written, is an input, or is being written by another process.
    """
    for path, suffixes in outputs:
        if path is not None:
            check_writable(path, suffixes)
    named = [path for path, _ in outputs if path is not None]
    check_distinct(named, inputs)
    with claimed(*named, *more):
        yield


@contextmanager
def importing_blender(what: str, line: str = "...") -> Iterator[None]:
    """Import modules that need Blender within this context; raises FacemimeError if one cannot be imported.

    `what` is the command, option or input that needs Blender, and `line` the command line to advise, after `facemime`.
    """
    try:
        with STOPPING.importing():
            yield
    except ImportError as error:
        raise FacemimeError(
            "{what} needs Blender ({error}). Run: blender --command facemime {line}, or install bpy.",
            what=what,
            error=error,
            line=line,
        ) from error
