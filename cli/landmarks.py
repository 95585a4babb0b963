"""The command `landmarks`: find the 66 landmarks of faces in images."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core.errors import OutputError, SourceError
from ..core.face.landmarks import N_LANDMARKS
from ..core.files.capture import check_readable, pictures_in, read_image, write_image
from ..core.files.writing import check_writable, replacing
from ..core.tracking.overlay import draw_landmarks
from ..core.tracking.tracker import FaceTracker, TrackingSettings
from .console import Progress, tell
from .job_files import outputs_of, place_beside
from .options import Commands, Options, add_command, add_output, add_settings, filled
from .stopping import INTERRUPTED, STOPPING


def add_commands(commands: Commands) -> None:
    """Add the command to the parser."""
    landmarks = add_command(commands, "landmarks", "find the 66 landmarks of faces in images")
    landmarks.add_argument("images", nargs="+", type=Path, metavar="IMAGE|FOLDER", help="images, or folders of images")
    add_output(landmarks, "FILE.npz", "names (N,), landmarks (N, 66, 2) in pixels or NaN, confidence (N,)")
    landmarks.add_argument(
        "--overlay", type=Path, metavar="DIR", help="also write copies of the images with the landmarks drawn on them"
    )
    add_settings(landmarks, TrackingSettings)
    landmarks.set_defaults(run=_run_landmarks)


def _run_landmarks(given: Options) -> int:
    """Run `facemime landmarks`: one row per image, NaN if there is no face; returns the exit status."""
    paths = _images(given["images"])
    with outputs_of(((given["output"], {".npz"}),), {}):
        tracker = FaceTracker.load(settings=filled(TrackingSettings, given))
        return _locate(paths, given["output"], given["overlay"], tracker)


def _locate(paths: Sequence[Path], output: Path, overlay: Path | None, tracker: FaceTracker) -> int:
    drawings = [] if overlay is None else _drawings(paths, overlay)
    landmarks = np.full((len(paths), N_LANDMARKS, 2), np.nan)
    confidence = np.zeros(len(paths))
    progress = Progress("Finding landmarks", len(paths), unit="images")
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
    content = io.BytesIO()  # in memory, as numpy reports a full disk a second time when the archive is discarded
    np.savez_compressed(content, names=names, landmarks=landmarks, confidence=confidence)
    with replacing(kept) as temporary:
        temporary.write_bytes(content.getvalue())
    found = int(np.isfinite(landmarks[:, 0, 0]).sum())
    progress.finish(f"a face in {found} of {len(paths)}")
    for problem in unreadable:
        tell(f"facemime: {problem}")
    if done < len(paths):
        tell(f"facemime: interrupted; the results of the first {done} images are in {kept}.")
        return INTERRUPTED
    return 1 if unreadable else 0


def _drawings(paths: Sequence[Path], folder: Path) -> list[Path]:
    """Files in `folder` for the drawings, named as the images, and numbered if names repeat.

    Raises OutputError if the folder cannot be written to, or contains one of the images.
    """
    drawings: dict[Path, None] = {}
    for path in paths:
        names = itertools.chain([path.stem], (f"{path.stem}-{number}" for number in itertools.count(2)))
        drawings[next(place for name in names if (place := folder / f"{name}.png") not in drawings)] = None
    pictures = {os.path.realpath(path) for path in paths}
    there = {os.path.dirname(picture) for picture in pictures}  # a link among the drawings may also lead to one
    if os.path.realpath(folder) in there or any(os.path.realpath(drawing) in pictures for drawing in drawings):
        raise OutputError(
            "Cannot draw in {folder}: it contains the images. Choose another folder for --overlay.", folder=folder
        )
    check_writable(next(iter(drawings)))
    return list(drawings)


def _images(paths: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        if os.path.isdir(path):
            files += pictures_in(path)
        elif check_readable(path):
            files.append(path)
        else:
            raise SourceError("There is no file or folder {path}. Check the path.", path=path)
    if not files:
        raise SourceError("There is no image in these folders. Use JPEG, PNG, BMP, TIFF or WebP.")
    return files
