"""The command `landmarks`: the 66 landmarks of the faces in pictures."""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core.capture import check_readable
from ..core.errors import OutputError, SourceError
from ..core.files import check_writable, reason_of, replacing
from ..core.images import IMAGE_SUFFIXES, read_image, write_image
from ..core.landmarks import N_LANDMARKS
from ..core.tracking.overlay import draw_landmarks
from ..core.tracking.tracker import FaceTracker
from .puppet.tracked import place_beside
from .terminal.console import Progress, tell
from .terminal.options import Commands, add_command, add_output
from .terminal.outputs import outputs_of
from .terminal.stopping import INTERRUPTED, STOPPING


def add_commands(commands: Commands) -> None:
    """Make the command known to the parser."""
    landmarks = add_command(commands, "landmarks", "find the 66 landmarks in pictures")
    landmarks.add_argument("images", nargs="+", type=Path, metavar="IMAGE|FOLDER", help="pictures, and folders of them")
    add_output(landmarks, "FILE.npz", "names (N,), landmarks (N, 66, 2) in pixels or NaN, confidence (N,)")
    landmarks.add_argument("--overlay", type=Path, metavar="DIR", help="also draw them over copies of the pictures")
    landmarks.set_defaults(run=run_landmarks)


def run_landmarks(arguments: argparse.Namespace) -> int:
    """`facemime landmarks`: one row per picture, NaN where there is no face; returns the exit status."""
    paths = _images(arguments.images)
    with outputs_of(((arguments.output, {".npz"}),), {}):
        return _locate(paths, arguments.output, arguments.overlay)


def _locate(paths: Sequence[Path], output: Path, overlay: Path | None) -> int:
    drawings = [] if overlay is None else _drawings(paths, overlay)
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
    kept = output if done == len(paths) else place_beside(output, output.suffix)
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
