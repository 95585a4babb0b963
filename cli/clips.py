"""The clips of a batch, and their records, which are checked, as others may write to the output folder.

A clip is done when its record exists in the output folder. The record is named by a checksum of the clip and of
everything that decides the result. A changed clip, another head or a new tracker therefore make a new record, and a
clip that was moved or listed twice is processed once.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from ..core.errors import DataError, SourceError
from ..core.files.assets import version
from ..core.files.capture import check_readable, require_utf8_name, unreadable_folder
from ..core.files.reading import as_integer, as_list, as_number, as_object, parse_json, read_text, shown
from ..core.files.suffixes import VIDEO_SUFFIXES
from ..core.files.writing import reason_of, replacing
from ..core.puppet.job import PuppetJob
from ..core.takes.take import Take
from ..core.tracking.tracker import FaceTracker

_MOST_FRAMES = 2**31
_MOST_SECONDS = 1e9
_MOST_OUTPUTS = 16
_MOST_POINTS = 1000
"""Largest number of points of the confidence curve."""
_MOST_PICTURES = 16
_MOST_CHARACTERS = 1000
"""Largest number of characters of the text that says what is missing."""


def checked_record(data: Any) -> dict[str, Any]:
    """Check a record, and drop unknown entries; raises ValueError if an entry is missing or of another kind."""
    given = as_object(data, "the record")
    record: dict[str, Any] = {
        "clip": _name(given.get("clip")),
        "outputs": [_name(name) for name in as_list(given.get("outputs"), "outputs", _MOST_OUTPUTS)],
        "frames": as_integer(given.get("frames"), "frames", 1, _MOST_FRAMES),
    }
    if not record["outputs"]:
        raise DataError("it names no outputs")
    record["found"] = as_integer(given.get("found"), "found", 0, record["frames"])
    record["missing"] = given.get("missing", "")  # earlier records lack it
    if not isinstance(record["missing"], str) or len(record["missing"]) > _MOST_CHARACTERS:
        raise DataError("{record} does not say what is missing", record=shown(record["missing"]))
    for name in ("length", "seconds"):
        record[name] = as_number(given.get(name), name, 0.0, _MOST_SECONDS)
    curve = as_list(given.get("confidence"), "confidence", _MOST_POINTS)
    record["confidence"] = [as_number(point, "confidence", 0.0, 1.0) for point in curve]
    worst = as_list(given.get("worst"), "worst", _MOST_PICTURES)
    record["worst"] = [as_number(time, "worst", -_MOST_SECONDS, _MOST_SECONDS) for time in worst]
    record["pictures"] = [_name(name) for name in as_list(given.get("pictures"), "pictures", _MOST_PICTURES)]
    return record


def _name(value: Any) -> str:
    """The name of a file; not a path, which might lead anywhere."""
    if not isinstance(value, str) or value in ("", ".", "..") or PurePath(value).name != value or "\\" in value:
        raise DataError("{value} is not the name of a file", value=shown(value))
    return value


PICTURES = "report"
"""Folder of the report's pages and pictures in the output folder."""
CHECKSUMS = ".checksums"
_CHECKSUM = re.compile("[0-9a-f]{64}")
_SETTLED = 2.0
"""Age of a file in seconds from which its time tells whether it has changed; FAT counts in steps of two seconds."""
_OUTPUTS = frozenset({".blend", ".facetake", ".png", ".pc2", ".abc"})
_MAX_LIST = 1 << 26
"""Longest list in characters; longer files are videos with an unusual suffix."""
_CURVE_POINTS = 300
"""Points of a confidence curve at most."""
_WORST_FRAMES = 3
"""Number of the least certain frames that are shown."""
_MIN_GAP = 0.5
"""Smallest time between two of these in seconds."""


@dataclass(frozen=True)
class Clip:
    """A clip, and the `name` of its outputs in the output folder."""

    path: Path
    name: str

    def output(self, folder: Path, suffix: str) -> Path:
        """An output of this clip in the output folder of the batch, by its suffix."""
        return folder / f"{self.name}{suffix}"


def find_clips(sources: Sequence[Path]) -> list[Path]:
    """Find clips in videos, folders (with subfolders), and lists with one path per line.

    Hidden files in folders are skipped, as macOS creates one beside each video that it copies to other disks. Paths in
    a list are relative to it; empty lines and those that begin with # are ignored. Missing files in a list are reported
    when they are processed. Raises SourceError if a source is missing or contains no clip.
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
            raise SourceError(
                "There is no video in {source}. Use files with {suffixes}.",
                source=source,
                suffixes=", ".join(sorted(VIDEO_SUFFIXES)),
            )
        clips += found
    return clips


def _videos_in(folder: Path) -> list[Path]:
    files = (path for path in folder.rglob("*") if not path.name.startswith(".") and os.path.isfile(path))
    try:
        os.listdir(folder)  # `rglob` ignores a folder that is not readable
        return sorted(path for path in files if path.suffix.lower() in VIDEO_SUFFIXES)
    except OSError as error:
        raise unreadable_folder(folder, error) from error


def _listed(path: Path) -> list[Path]:
    try:
        with open(path, encoding="utf-8-sig") as stream:
            text = stream.read(_MAX_LIST + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise _no_list(path) from error
    if len(text) > _MAX_LIST or "\0" in text:
        raise _no_list(path)
    lines = (line.strip() for line in text.splitlines())
    return [path.parent / line for line in lines if line and not line.startswith("#")]


def _no_list(path: Path) -> SourceError:
    return SourceError(
        "{path} is neither a folder nor a list of clips. Use a folder, or a UTF-8 text with one path per line.",
        path=path,
    )


class Checksums:
    """SHA-256 of files, kept in the output folder by path, size and time, as clips may be large and many.

    Several processes and machines may add to the file; a line that they have mixed up is ignored.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._file = None if folder is None else folder / CHECKSUMS
        self._known: dict[tuple[str, int, int], str] = {}
        if self._file is not None:
            self._read(self._file)

    def of(self, path: Path) -> str:
        """Return the checksum of a file; SourceError if it cannot be read."""
        check_readable(path)
        try:
            before = os.stat(path)
            key = os.path.abspath(path), before.st_size, before.st_mtime_ns
            if key not in self._known:
                with open(path, "rb") as stream:
                    self._known[key] = hashlib.file_digest(stream, "sha256").hexdigest()
                self._keep(key, before.st_mtime)
        except OSError as error:
            raise SourceError(
                "{path} cannot be read: {error}. Check the path.", path=path, error=reason_of(error)
            ) from error
        return self._known[key]

    def _read(self, file: Path) -> None:
        try:
            lines = file.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
        except OSError:  # not written yet
            return
        for line in lines:
            with suppress(ValueError, TypeError):
                path, size, time_ns, digest = json.loads(line)
                if _CHECKSUM.fullmatch(digest):
                    self._known[str(path), int(size), int(time_ns)] = digest

    def _keep(self, key: tuple[str, int, int], changed: float) -> None:
        """Add a line, unless the file has changed so lately that it may change again without another time."""
        if self._file is None or time.time() - changed < _SETTLED or not self._file.parent.is_dir():
            return
        line = json.dumps([*key, self._known[key]]) + "\n"
        with suppress(OSError), open(self._file, "a", encoding="utf-8") as stream:  # it is computed again next time
            stream.write(line)


class Namer:
    """Names the clips of a job by their file name and a checksum of everything that decides the result."""

    def __init__(self, job: PuppetJob, checksums: Checksums | None = None) -> None:
        self._checksums = Checksums() if checksums is None else checksums
        files = {
            **{"head": None if job.head is None else job.head.path, "points": job.points},
            **{"map": job.map, "style": job.style},
        }
        decides = {
            "settings": asdict(job.settings),
            "face": job.face,
            "object": None if job.head is None else job.head.name,
            "model": FaceTracker.load(settings=job.settings.tracking).model_id,
            "facemime": version(),
            **{name: None if path is None else self._checksums.of(path) for name, path in files.items()},
        }
        self._settings = json.dumps(decides, sort_keys=True).encode()

    def clip(self, path: Path) -> Clip:
        """Name the clip at `path`; SourceError if it cannot be read."""
        require_utf8_name(path)
        key = hashlib.sha256(self._checksums.of(path).encode() + self._settings).hexdigest()
        return Clip(path, f"{path.stem}-{key[:12]}")


def read_record(clip: Clip, folder: Path) -> dict[str, Any] | None:
    """The record of a clip in the output folder; None if it is not done, or its outputs are missing."""
    try:
        record = checked_record(parse_json(read_text(clip.output(folder, ".json"))))
    except (OSError, ValueError):  # missing, truncated or not a record: the clip is processed again
        return None
    return record if all((folder / name).is_file() for name in record["outputs"]) else None


def write_record(clip: Clip, folder: Path, take: Take, seconds: float, pictures: Mapping[str, bytes]) -> None:
    """Write the record of a clip for the report, after all other outputs: its existence means that the clip is done.

    It has the seconds that processing took, and JPEG files for the report by the ends of their names.
    """
    (folder / PICTURES).mkdir(exist_ok=True)
    names = {f"{clip.name}-{end}.jpg": data for end, data in pictures.items()}
    for name, data in names.items():
        with replacing(folder / PICTURES / name) as temporary:
            temporary.write_bytes(data)
    record = {
        "clip": clip.path.name,
        "outputs": sorted(path.name for path in folder.glob(f"{glob.escape(clip.name)}.*") if path.suffix in _OUTPUTS),
        "frames": len(take),
        "found": int(take.found.sum()),
        "missing": str(take.info.get("recovered", "")),
        "length": float(take.times[-1] - take.times[0]),
        "seconds": seconds,
        "confidence": confidence_curve(take),
        "worst": [round(float(take.times[frame]), 2) for frame in worst_frames(take)],
        "pictures": list(names),
    }
    with replacing(clip.output(folder, ".json")) as temporary:
        temporary.write_text(json.dumps(record), encoding="utf-8")


def confidence_curve(take: Take) -> list[float]:
    """Confidence over time as the minima of at most some hundred spans; 0 where lost."""
    sure = np.where(take.found, take.confidence, 0.0)
    parts = np.array_split(sure, min(_CURVE_POINTS, len(sure)))
    return [round(float(part.min()), 3) for part in parts]


def worst_frames(take: Take) -> list[int]:
    """The least certain frames, some time apart, in order of time."""
    sure = np.where(take.found, take.confidence, 0.0)
    chosen: list[int] = []
    for frame in np.argsort(sure, kind="stable").tolist():
        if all(abs(take.times[frame] - take.times[other]) >= _MIN_GAP for other in chosen):
            chosen.append(frame)
        if len(chosen) == _WORST_FRAMES:
            break
    return sorted(chosen)
