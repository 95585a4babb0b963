"""The command `facemime`: the same work as the operators', without Blender's window.

`landmarks` and `track` need no Blender; `puppet` runs where `bpy` can be imported: the bpy module, or Blender itself
as `blender --command facemime puppet ...`.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..core.capture import require_file
from ..core.control_points import from_json, parse_landmarks, select_for_take, to_json
from ..core.deform.greedy import GreedySelection
from ..core.deform.regions import REGIONS
from ..core.drive import built_in_rig
from ..core.errors import FacemimeError, OutputError, SourceError
from ..core.files import check_writable, replacing
from ..core.images import IMAGE_SUFFIXES, read_image, write_image
from ..core.landmarks import IBUG68_INDICES, N_LANDMARKS
from ..core.overlay import draw_landmarks
from ..core.pipeline import track_video
from ..core.retarget import calibrate
from ..core.takes.file import SUFFIX, load_take, save_take
from ..core.takes.smooth import smooth_take
from ..core.takes.take import Take
from ..core.tracking.tracker import FaceTracker
from ..core.version import version
from .batch import add_commands as add_batch_commands
from .console import Progress, say
from .options import add_bake_options, add_command, add_face_option, add_head_options, add_output, face_of
from .takes import add_commands as add_take_commands
from .takes import load_telling

INTERRUPTED = 130
_UNFINISHED, _INTERRUPTED = f".unfinished{SUFFIX}", f".interrupted{SUFFIX}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, 1 for an error that was told, 2 for usage, 130 for Ctrl-C."""
    with contextlib.ExitStack() as stack:
        if sys.stderr is None:  # closed by whoever called
            stack.enter_context(contextlib.redirect_stderr(stack.enter_context(open(os.devnull, "w"))))
        arguments = _parser().parse_args(argv)
        try:
            return int(arguments.run(arguments))
        except FacemimeError as error:
            print(f"facemime: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt as stop:
            print(f"facemime: interrupted; {stop or 'what was written before stays'}.", file=sys.stderr)
            return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="facemime", description="Live face puppetry for Blender.")
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
    puppet.add_argument("--neutral", type=float, metavar="SECONDS", help="where the neutral second starts; else found")
    add_head_options(puppet)
    add_bake_options(puppet)
    puppet.set_defaults(run=run_puppet)

    select = add_command(commands, "select", "choose the control points that a take needs on the built-in head")
    select.add_argument("take", type=Path, metavar="TAKE.facetake", help="what track made")
    select.add_argument("-o", "--output", type=Path, metavar="POINTS.json", help="for puppet --points")
    select.add_argument("--tolerance", type=float, default=1.0, metavar="PERCENT", help="of the face's width (1)")
    select.add_argument(
        "--max-points", type=int, default=N_LANDMARKS, metavar="N", help=f"at most so many ({N_LANDMARKS})"
    )
    select.add_argument("--add", default="", metavar="17,19-21", help="landmarks to have in any case, iBUG numbers")
    select.add_argument("--remove", default="", metavar="0-3,30", help="landmarks never to have")
    select.add_argument("--neutral", type=float, metavar="SECONDS", help="where the neutral second starts; else found")
    select.set_defaults(run=run_select)

    add_take_commands(commands)
    add_batch_commands(commands)
    return parser


def run_landmarks(arguments: argparse.Namespace) -> int:
    """`facemime landmarks`: one row a picture, NaN where there is no face."""
    paths = _images(arguments.images)
    check_writable(arguments.output, {".npz"})
    drawings = [] if arguments.overlay is None else _drawings(paths, arguments.overlay)
    tracker = FaceTracker.load()
    landmarks = np.full((len(paths), N_LANDMARKS, 2), np.nan)
    confidence = np.zeros(len(paths))
    progress = Progress("Finding landmarks", len(paths), unit="pictures")
    unreadable: list[SourceError] = []
    done = 0
    with contextlib.suppress(KeyboardInterrupt):
        for i, path in enumerate(paths):
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
    names, landmarks, confidence = np.array([path.name for path in paths[:done]]), landmarks[:done], confidence[:done]
    with replacing(arguments.output) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(stream, names=names, landmarks=landmarks, confidence=confidence)
    found = int(np.isfinite(landmarks[:, 0, 0]).sum())
    progress.finish(f"a face in {found} of {len(paths)}")
    for error in unreadable:
        print(f"facemime: {error}", file=sys.stderr)
    if done < len(paths):
        print(f"facemime: interrupted; the first {done} pictures are in {arguments.output}.", file=sys.stderr)
        return INTERRUPTED
    return 1 if unreadable else 0


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
    if any(path.parent.resolve() == folder.resolve() for path in paths):
        raise OutputError(f"Cannot draw in {folder}: the pictures themselves are there. Give --overlay another folder.")
    check_writable(next(iter(drawings)))
    return list(drawings)


def run_track(arguments: argparse.Namespace) -> int:
    """`facemime track`: a video to a take."""
    check_writable(arguments.output, {SUFFIX})
    unfinished = arguments.output.with_suffix(_UNFINISHED)
    with _telling_of(unfinished):
        take = _track(arguments.video, unfinished, face_of(arguments.face))
        if arguments.smooth:
            take = smooth_take(take)
            save_take(take, unfinished)
        if take.info.get("interrupted"):
            return _interrupted(take, unfinished, arguments.output)
        _settle(unfinished, arguments.output)
    return 0


def run_puppet(arguments: argparse.Namespace) -> int:
    """`facemime puppet`: a video or a take to an animated head, and pictures of it."""
    try:
        from . import headless
    except ImportError as error:
        raise FacemimeError(
            f"puppet needs Blender ({error}). Run: blender --command facemime puppet ..., or install bpy."
        ) from error
    _check_outputs(arguments)
    bake = headless.bake_settings(arguments)
    points = None if arguments.points is None else from_json(_text(arguments.points))
    scene, head = headless.open_head(arguments.head, points, bake)
    if arguments.source.suffix.lower() == SUFFIX:
        take = load_telling(arguments.source)
        if arguments.take is not None:
            save_take(take, arguments.take)
        headless.puppet(arguments, scene, head, take, None, bake)
        return 0
    unfinished = (arguments.take or arguments.output).with_suffix(_UNFINISHED)
    with _telling_of(unfinished):
        take = _track(arguments.source, unfinished, face_of(arguments.face))
        if take.info.get("interrupted"):
            return _interrupted(take, unfinished, arguments.take or arguments.output.with_suffix(_INTERRUPTED))
        if arguments.take is not None:
            _settle(unfinished, arguments.take)
        headless.puppet(arguments, scene, head, take, arguments.source, bake)
    unfinished.unlink(missing_ok=True)
    return 0


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Raise OutputError now where one of the outputs of `puppet` cannot be written, or is the video itself."""
    if arguments.preview is not None and arguments.preview.resolve() == arguments.source.resolve():
        raise OutputError(f"Cannot write {arguments.preview}: it is the video that is tracked. Give another name.")
    for path, suffixes in (
        (arguments.output, {".blend"}),
        (arguments.preview, {".mp4"}),
        (arguments.sheet, {".png", ".jpg"}),
        (arguments.take, {SUFFIX}),
    ):
        if path is not None:
            check_writable(path, suffixes)


def run_select(arguments: argparse.Namespace) -> int:
    """`facemime select`: a take to control points; the curve of error goes to the output, a line a step."""
    if arguments.output is not None:
        check_writable(arguments.output, {".json"})
    if not arguments.tolerance > 0:
        raise FacemimeError(f"The tolerance must be above 0 %; got {arguments.tolerance}.")
    take = load_telling(arguments.take)
    selection = select_for_take(
        built_in_rig(),
        take,
        neutral=calibrate(take, arguments.neutral),
        tolerance=arguments.tolerance / 100.0,
        max_points=arguments.max_points,
        always=parse_landmarks(arguments.add),
        never=parse_landmarks(arguments.remove),
    )
    if arguments.output is not None:
        with replacing(arguments.output) as temporary:
            temporary.write_text(to_json(selection) + "\n", encoding="utf-8")
    say(_table(selection))
    if not selection.reached:
        print("facemime: the tolerance was not reached; allow more points, or a larger one.", file=sys.stderr)
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
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path} cannot be read ({error}). Give a file that facemime select -o wrote.") from error


def _track(video: Path, unfinished: Path, face: tuple[float, float] | None) -> Take:
    """The take of `video`, written to `unfinished` as it grows; what an earlier run left there is replaced."""
    tracker = FaceTracker.load()
    progress = Progress(f"Tracking {video.name}")
    require_file(video)
    unfinished.unlink(missing_ok=True)
    track_video(video, tracker, lambda done, total, _: progress.update(done, total), unfinished, face)
    if not unfinished.exists():
        raise FacemimeError(f"Interrupted before the first frame of {video}. Start it again.")
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
    _settle(unfinished, kept)
    print(f"facemime: interrupted; the {len(take)} frames tracked are in {kept}.", file=sys.stderr)
    return INTERRUPTED


def _settle(unfinished: Path, kept: Path) -> None:
    """Give a finished take its name."""
    with replacing(kept) as temporary:
        os.replace(unfinished, temporary)


def _images(paths: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        elif path.exists():
            files.append(path)
        else:
            raise SourceError(f"There is no file or folder {path}. Check the path.")
    if not files:
        raise SourceError("There is no picture in the folders given. JPEG, PNG, BMP, TIFF and WebP are read.")
    return files
