"""Which clips there are, which of them are done, and what is kept of each.

A clip is done when its record lies in the output folder. The record's name holds the checksum of the clip and of all
that decides what comes out, so that a clip that changed, another head or a new tracker make a new one, and whatever was
moved or listed twice is done once.
"""

from __future__ import annotations

import base64
import glob
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...core.capture import check_readable, require_utf8_name
from ...core.errors import SourceError
from ...core.files import reason_of, replacing
from ...core.puppet.job import PuppetJob
from ...core.reading import parse_json, read_text
from ...core.takes.take import Take
from ...core.tracking.tracker import FaceTracker
from ...core.version import version
from .record import checked_record

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v"})
_OUTPUTS = frozenset({".blend", ".facetake", ".png", ".pc2", ".abc"})
_LONGEST_LIST = 1 << 26
"""Characters; what is longer is a film with an unusual suffix."""
_CURVE_POINTS = 300
_WORST, _APART = 3, 0.5


@dataclass(frozen=True)
class Clip:
    """A clip to be done: `name` is what its outputs are called in the folder of outputs."""

    path: Path
    name: str

    def output(self, folder: Path, suffix: str) -> Path:
        """A file of this clip in the folder of outputs."""
        return folder / f"{self.name}{suffix}"


def find_clips(sources: Sequence[Path]) -> list[Path]:
    """The clips that `sources` name: videos, folders of videos and of such folders, and lists, a path a line.

    Of a folder, hidden files are left out: macOS puts one beside each video that it copies to other disks.
    Paths of a list are relative to it; empty lines and those that begin with # are left out. What a list names need not
    exist: that is found out, and told, when its turn comes.

    Raises
    ------
    SourceError
        Where a source is missing or there is no clip in it.
    """
    clips: list[Path] = []
    for source in sources:
        if os.path.isdir(source):
            found = _videos_in(source)
        elif not check_readable(source) and source.suffix.lower() not in VIDEO_SUFFIXES:
            raise _no_list(source)
        else:
            found = [source] if source.suffix.lower() in VIDEO_SUFFIXES else _listed(source)
        if not found:
            raise SourceError(f"There is no clip in {source}. Videos are {', '.join(sorted(VIDEO_SUFFIXES))}.")
        clips += found
    return clips


def _videos_in(folder: Path) -> list[Path]:
    files = (path for path in folder.rglob("*") if not path.name.startswith(".") and os.path.isfile(path))
    try:
        os.listdir(folder)  # `rglob` says nothing of a folder that may not be read
        return sorted(path for path in files if path.suffix.lower() in VIDEO_SUFFIXES)
    except OSError as error:
        raise SourceError(f"The folder {folder} cannot be read: {reason_of(error)}. Change its permissions.") from error


def _listed(path: Path) -> list[Path]:
    try:
        with open(path, encoding="utf-8-sig") as stream:
            text = stream.read(_LONGEST_LIST + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise _no_list(path) from error
    if len(text) > _LONGEST_LIST or "\0" in text:
        raise _no_list(path)
    lines = (line.strip() for line in text.splitlines())
    return [path.parent / line for line in lines if line and not line.startswith("#")]


def _no_list(path: Path) -> SourceError:
    return SourceError(f"{path} is no folder and no list of clips. Give a folder, or a text in UTF-8, a path a line.")


class Namer:
    """Gives clips their names: the file's own, and a checksum of all that decides what comes out.

    Parameters
    ----------
    job : PuppetJob
        What is done with each clip.
    """

    def __init__(self, job: PuppetJob) -> None:
        files = {"head": None if job.head is None else job.head.path, "points": job.points, "map": job.map}
        decides = {
            "settings": asdict(job.settings),
            "face": job.face,
            "object": None if job.head is None else job.head.name,
            "model": FaceTracker.load().model_id,
            "facemime": version(),
            **{name: None if path is None else checksum(path) for name, path in files.items()},
        }
        self._settings = json.dumps(decides, sort_keys=True).encode()

    def clip(self, path: Path) -> Clip:
        """The clip at `path`; SourceError where it cannot be read."""
        require_utf8_name(path)
        key = hashlib.sha256(checksum(path).encode() + self._settings).hexdigest()
        return Clip(path, f"{path.stem}-{key[:12]}")


def checksum(path: Path) -> str:
    """SHA-256 of a file's content; SourceError where it cannot be read."""
    check_readable(path)
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {reason_of(error)}. Check the path.") from error


def read_record(clip: Clip, folder: Path) -> dict[str, Any] | None:
    """What is kept of a clip that is done; None where it is not, or where its outputs are gone."""
    try:
        record = checked_record(parse_json(read_text(clip.output(folder, ".json"))))
    except (OSError, ValueError):  # missing, cut off or not a record: the clip is done again
        return None
    return record if all((folder / name).is_file() for name in record["outputs"]) else None


def write_record(clip: Clip, folder: Path, take: Take, seconds: float, thumbnails: Sequence[bytes]) -> None:
    """Keep what a report tells of a clip, last of all its outputs: that it is there means that the clip is done."""
    record = {
        "clip": clip.path.name,
        "outputs": sorted(path.name for path in folder.glob(f"{glob.escape(clip.name)}.*") if path.suffix in _OUTPUTS),
        "frames": len(take),
        "found": int(take.found.sum()),
        "length": float(take.times[-1] - take.times[0]),
        "seconds": seconds,
        "confidence": confidence_curve(take),
        "worst": [round(float(take.times[frame]), 2) for frame in worst_frames(take)],
        "thumbnails": [base64.b64encode(picture).decode() for picture in thumbnails],
    }
    with replacing(clip.output(folder, ".json")) as temporary:
        temporary.write_text(json.dumps(record), encoding="utf-8")


def confidence_curve(take: Take) -> list[float]:
    """The confidence over time, at most some hundred points: of each stretch of frames the least, 0 where lost."""
    sure = np.where(take.found, take.confidence, 0.0)
    parts = np.array_split(sure, min(_CURVE_POINTS, len(sure)))
    return [round(float(part.min()), 3) for part in parts]


def worst_frames(take: Take) -> list[int]:
    """The frames of which the tracker is least sure, some time apart, in order of time."""
    sure = np.where(take.found, take.confidence, 0.0)
    chosen: list[int] = []
    for frame in np.argsort(sure, kind="stable").tolist():
        if all(abs(take.times[frame] - take.times[other]) >= _APART for other in chosen):
            chosen.append(frame)
        if len(chosen) == _WORST:
            break
    return sorted(chosen)
