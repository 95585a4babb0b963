"""The command `facemime`: the same work as the operators', without Blender's window.

`landmarks` and `track` need no Blender; `puppet` runs where `bpy` can be imported: the bpy module, or Blender itself
as `blender --command facemime puppet ...`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..core.capture import check_readable, require_file, require_utf8_name
from ..core.control_points.greedy import GreedySelection
from ..core.control_points.select import from_json, parse_landmarks, select_for_take, to_json
from ..core.errors import FacemimeError, OutputError, SourceError
from ..core.files import check_writable, free_name, reason_of, replacing, settle
from ..core.heads.regions import REGIONS
from ..core.heads.rig import built_in_rig
from ..core.images import IMAGE_SUFFIXES, read_image, write_image
from ..core.landmarks import IBUG68_INDICES, N_LANDMARKS
from ..core.reading import read_text
from ..core.takes.file import SUFFIX, load_take, save_take
from ..core.takes.from_video import track_video
from ..core.takes.neutral import calibrate
from ..core.takes.smooth import smooth_take
from ..core.takes.take import Take
from ..core.tracking.overlay import draw_landmarks
from ..core.tracking.result import TrackResult
from ..core.tracking.tracker import FaceTracker
from ..core.version import version
from .batch.command import add_commands as add_batch_commands
from .takes import add_commands as add_take_commands
from .takes import load_telling
from .terminal.console import Progress, say, tell
from .terminal.options import (
    Parser,
    add_bake_options,
    add_command,
    add_face_option,
    add_head_options,
    add_output,
    face_of,
    head_file,
    number,
    whole_number,
)
from .terminal.outputs import outputs_of
from .terminal.stopping import INTERRUPTED, STOPPING

_UNFINISHED, _INTERRUPTED = f".unfinished{SUFFIX}", ".interrupted"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Returns
    -------
    int
        The exit status: 0, 1 for an error that was told, 2 for usage, 130 for Ctrl-C, 143 for SIGTERM.
    """
    with contextlib.ExitStack() as stack:
        if sys.stderr is None:  # closed by whoever called
            stack.enter_context(contextlib.redirect_stderr(stack.enter_context(open(os.devnull, "w"))))
        try:
            arguments = _parser().parse_args(argv)
            status = int(arguments.run(arguments))
        except FacemimeError as error:
            tell(f"facemime: {error}")
            return 1
        except KeyboardInterrupt as stop:
            kept = f"; {stop}" if str(stop) else ". Files that were complete before are kept"
            tell(f"facemime: interrupted{kept}.")
            status = INTERRUPTED
        return STOPPING.status if status == INTERRUPTED else status


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="facemime", description="Live face puppetry for Blender.")
    parser.add_argument("--version", action="version", version=f"facemime {version()}")
    commands = parser.add_subparsers(dest="command", required=True)

    landmarks = add_command(commands, "landmarks", "find the 66 landmarks in pictures")
    landmarks.add_argument("images", nargs="+", type=Path, metavar="IMAGE|FOLDER", help="pictures, and folders of them")
    add_output(landmarks, "FILE.npz", "names (N,), landmarks (N, 66, 2) in pixels or NaN, confidence (N,)")
    landmarks.add_argument("--overlay", type=Path, metavar="DIR", help="also draw them over copies of the pictures")
    landmarks.set_defaults(run=run_landmarks)

    track = add_command(commands, "track", "track a face through a video")
    track.add_argument("video", type=Path, metavar="VIDEO", help="what FFmpeg reads; MP4 (H.264) is safe")
    add_output(track, "TAKE.facetake", "all that was tracked, to move any head by; it is there while it grows")
    track.add_argument("--smooth", action="store_true", help="hold still what does not move")
    add_face_option(track)
    track.set_defaults(run=run_track)

    puppet = add_command(commands, "puppet", "move a head by a video or a take, as Blender animation")
    puppet.add_argument("source", type=Path, metavar="VIDEO|TAKE", help="a video, or what track made of one")
    add_output(puppet, "OUT.blend", "the head with its animation")
    puppet.add_argument("--preview", type=Path, metavar="OUT.mp4", help="video of performer and avatar side by side")
    puppet.add_argument("--sheet", type=Path, metavar="OUT.png", help="contact sheet of the most different expressions")
    puppet.add_argument("--take", type=Path, metavar="TAKE.facetake", help="also keep the take")
    puppet.add_argument("--neutral", type=number, metavar="SECONDS", help="where the neutral second starts; else found")
    add_head_options(puppet)
    add_bake_options(puppet)
    puppet.set_defaults(run=run_puppet)

    select = add_command(commands, "select", "choose the control points that a take needs on the built-in head")
    select.add_argument("take", type=Path, metavar="TAKE.facetake", help="what track made")
    select.add_argument("-o", "--output", type=Path, metavar="POINTS.json", help="for puppet --points")
    select.add_argument("--tolerance", type=number, default=1.0, metavar="PERCENT", help="of the face's width (1)")
    select.add_argument(
        "--max-points", type=whole_number, default=N_LANDMARKS, metavar="N", help=f"at most so many ({N_LANDMARKS})"
    )
    select.add_argument("--add", default="", metavar="17,19-21", help="landmarks to have in any case, iBUG numbers")
    select.add_argument("--remove", default="", metavar="0-3,30", help="landmarks never to have")
    select.add_argument("--neutral", type=number, metavar="SECONDS", help="where the neutral second starts; else found")
    select.set_defaults(run=run_select)

    add_take_commands(commands)
    add_batch_commands(commands)
    return parser


def run_landmarks(arguments: argparse.Namespace) -> int:
    """`facemime landmarks`: one row a picture, NaN where there is no face."""
    paths = _images(arguments.images)
    with outputs_of(((arguments.output, {".npz"}),), {}):
        return _locate(paths, arguments)


def _locate(paths: Sequence[Path], arguments: argparse.Namespace) -> int:
    drawings = [] if arguments.overlay is None else _drawings(paths, arguments.overlay)
    tracker = FaceTracker.load()
    landmarks = np.full((len(paths), N_LANDMARKS, 2), np.nan)
    confidence = np.zeros(len(paths))
    progress = Progress("Finding landmarks", len(paths), unit="pictures")
    unreadable: list[SourceError] = []
    done = 0
    with contextlib.suppress(KeyboardInterrupt), STOPPING.noting():
        for i, path in enumerate(paths):
            STOPPING.check()
            try:
                image = read_image(path)
            except SourceError as error:
                unreadable.append(error)
            else:
                result = tracker.locate(image)
                landmarks[i], confidence[i] = result.landmarks, result.confidence
                if drawings:
                    write_image(drawings[i], draw_landmarks(image, result.landmarks))
            done = i + 1
            progress.update(done)
    kept = arguments.output if done == len(paths) else _beside(arguments.output, arguments.output.suffix)
    names, landmarks, confidence = np.array([path.name for path in paths[:done]]), landmarks[:done], confidence[:done]
    content = io.BytesIO()  # an archive that meets the end of the disk complains once more when it is thrown away
    np.savez_compressed(content, names=names, landmarks=landmarks, confidence=confidence)
    with replacing(kept) as temporary:
        temporary.write_bytes(content.getvalue())
    found = int(np.isfinite(landmarks[:, 0, 0]).sum())
    progress.finish(f"a face in {found} of {len(paths)}")
    for error in unreadable:
        tell(f"facemime: {error}")
    if done < len(paths):
        tell(f"facemime: interrupted; the first {done} pictures are in {kept}.")
        return INTERRUPTED
    return 1 if unreadable else 0


def _beside(output: Path, suffix: str) -> Path:
    """Where the part of an interrupted run goes: `output` where nothing is there yet, a free name beside it else."""
    if not os.path.lexists(output):
        return output
    return free_name(output.with_suffix(f"{_INTERRUPTED}{suffix}"))


def _drawings(paths: Sequence[Path], folder: Path) -> list[Path]:
    """Where each picture is drawn: in `folder`, under its own name, numbered where several have the same.

    Raises
    ------
    OutputError
        Where nothing can be written there, or one of the pictures themselves lies there.
    """
    drawings: dict[Path, None] = {}
    for path in paths:
        names = itertools.chain([path.stem], (f"{path.stem}-{number}" for number in itertools.count(2)))
        drawings[next(place for name in names if (place := folder / f"{name}.png") not in drawings)] = None
    pictures = {os.path.realpath(path) for path in paths}
    there = {os.path.dirname(picture) for picture in pictures}  # and a link among the drawings may lead to one
    if os.path.realpath(folder) in there or any(os.path.realpath(drawing) in pictures for drawing in drawings):
        raise OutputError(f"Cannot draw in {folder}: the pictures themselves are there. Give --overlay another folder.")
    check_writable(next(iter(drawings)))
    return list(drawings)


def run_track(arguments: argparse.Namespace) -> int:
    """`facemime track`: a video to a take."""
    unfinished = arguments.output.with_suffix(_UNFINISHED)
    outputs, inputs = ((arguments.output, {SUFFIX}),), {"the video that is tracked": arguments.video}
    with outputs_of(outputs, inputs, unfinished), _telling_of(unfinished := _unused(unfinished)):
        take = _track(arguments.video, unfinished, face_of(arguments.face))
        if arguments.smooth:
            take = smooth_take(take)
            save_take(take, unfinished)
        if take.info.get("interrupted"):
            return _interrupted(take, unfinished, _beside(arguments.output, SUFFIX))
        settle(unfinished, arguments.output)
    return 0


def run_puppet(arguments: argparse.Namespace) -> int:
    """`facemime puppet`: a video or a take to an animated head, and pictures of it."""
    try:
        with STOPPING.importing():
            from . import headless
    except ImportError as error:
        raise FacemimeError(
            f"puppet needs Blender ({error}). Run: blender --command facemime puppet ..., or install bpy."
        ) from error
    outputs = (
        (arguments.output, {".blend"}),
        (arguments.preview, {".mp4"}),
        (arguments.sheet, {".png", ".jpg"}),
        (arguments.take, {SUFFIX}),
    )
    tracked = arguments.source.suffix.lower() != SUFFIX
    inputs = {
        "the video that is tracked" if tracked else "the take that moves the head": arguments.source,
        "the file of the head": head_file(arguments.head)[0],
        "the file of the control points": arguments.points,
        "the table of keys": arguments.map,
    }
    for path, _ in outputs:
        if path is not None:
            require_utf8_name(path)
    unfinished = (arguments.take or arguments.output).with_suffix(_UNFINISHED)
    with outputs_of(outputs, inputs, *([unfinished] if tracked else [])):
        bake = headless.bake_settings(arguments)
        points = None if arguments.points is None else from_json(_text(arguments.points))
        scene, head = headless.open_head(arguments.head, points, bake)
        if not tracked:
            take = load_telling(arguments.source)
            if arguments.take is not None:
                save_take(take, arguments.take)
            headless.puppet(arguments, scene, head, take, None, bake)
            return 0
        with _telling_of(unfinished := _unused(unfinished)):
            take = _track(arguments.source, unfinished, face_of(arguments.face))
            if take.info.get("interrupted"):
                kept = arguments.take or arguments.output.with_suffix(f"{_INTERRUPTED}{SUFFIX}")
                return _interrupted(take, unfinished, _beside(kept, SUFFIX) if arguments.take else free_name(kept))
            if arguments.take is not None:
                settle(unfinished, arguments.take)
            headless.puppet(arguments, scene, head, take, arguments.source, bake)
        unfinished.unlink(missing_ok=True)
    return 0


def run_select(arguments: argparse.Namespace) -> int:
    """`facemime select`: a take to control points; the curve of error goes to the output, a line a step."""
    if not arguments.tolerance > 0:
        raise FacemimeError(f"The tolerance must be above 0 %; got {arguments.tolerance}.")
    always, never = parse_landmarks(arguments.add), parse_landmarks(arguments.remove)
    with outputs_of(((arguments.output, {".json"}),), {"the take that is read": arguments.take}):
        take = load_telling(arguments.take)
        selection = select_for_take(
            built_in_rig(),
            take,
            neutral=calibrate(take, arguments.neutral),
            tolerance=arguments.tolerance / 100.0,
            max_points=arguments.max_points,
            always=always,
            never=never,
        )
        if arguments.output is not None:
            with replacing(arguments.output) as temporary:
                temporary.write_text(to_json(selection) + "\n", encoding="utf-8")
    say(_table(selection))
    if not selection.reached:
        tell("facemime: the tolerance was not reached; allow more points, or a larger one.")
    return 0


def _table(selection: GreedySelection) -> str:
    """A line a step, and one with the control points."""
    lines = ["action  landmark  region  points  worst error %  in frame  at landmark  reason"]
    for step in selection.steps:
        landmark, worst = IBUG68_INDICES[[step.landmark, step.worst]]
        lines.append(
            f"{step.action:6}  {landmark:8}  {REGIONS[step.region].name:6}  {step.points:6}  {100 * step.error:13.2f}  "
            f"{step.frame:8}  {worst:11}  {step.reason}"
        )
    chosen = ", ".join(str(number) for number in IBUG68_INDICES[selection.landmarks])
    return "\n".join([*lines, f"{len(selection.landmarks)} control points: {chosen}"])


def _text(path: Path) -> str:
    check_readable(path)
    try:
        return read_text(path)
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read ({error}). Give a file that facemime select -o wrote.") from error


def _unused(unfinished: Path) -> Path:
    """A free name for an unfinished take; says so if an earlier run left one, which is kept."""
    name = free_name(unfinished)
    if name != unfinished:
        tell(f"facemime: {unfinished} is what an earlier run tracked before it was broken off; it is kept.")
    return name


def _track(video: Path, unfinished: Path, face: tuple[float, float] | None) -> Take:
    """The take of `video`, written to `unfinished` as it grows."""
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


@contextlib.contextmanager
def _telling_of(unfinished: Path) -> Iterator[None]:
    """Where what follows fails or is interrupted, say that what was tracked is in `unfinished`, if it is."""
    try:
        yield
    except FacemimeError as error:
        if str(unfinished) in str(error) or not unfinished.exists():
            raise
        raise type(error)(f"{error} What was tracked is in {unfinished}.") from error
    except KeyboardInterrupt as stop:
        if not unfinished.exists():
            raise
        raise KeyboardInterrupt(f"what was tracked is in {unfinished}") from stop


def _interrupted(take: Take, unfinished: Path, kept: Path) -> int:
    """Give what was tracked until Ctrl-C its name, and say so; returns the exit status."""
    settle(unfinished, kept)
    tell(f"facemime: interrupted; the {len(take)} frames tracked are in {kept}.")
    return INTERRUPTED


def _images(paths: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        if os.path.isdir(path):
            files += _pictures_in(path)
        elif check_readable(path):
            files.append(path)
        else:
            raise SourceError(f"There is no file or folder {path}. Check the path.")
    if not files:
        raise SourceError("There is no picture in the folders given. JPEG, PNG, BMP, TIFF and WebP are read.")
    return files


def _pictures_in(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    except OSError as error:
        raise SourceError(f"The folder {folder} cannot be read: {reason_of(error)}. Change its permissions.") from error
