"""Recordings of other programs as takes, told apart by their content."""

from __future__ import annotations

import csv
from pathlib import Path

from ..errors import Message, SourceError
from ..media.capture import check_readable
from ..takes.coefficient_table import from_any_csv
from ..takes.table_angles import AUTOMATIC
from ..takes.table_text import SUFFIXES as TABLES
from ..takes.table_text import read_decoded, read_table
from ..takes.take import Take
from .curves import CoefficientTrack, recorded
from .other_programs import OPENFACE_TITLES, is_face_cap, read_audio2face, read_face_cap, read_openface
from .unity_clip import read_unity_clip

SUFFIXES = (*TABLES, ".json", ".anim")
"""Suffixes of what can be read."""
_MIN_UNITS = 8
"""Titles of OpenFace's action units by which its tables are recognised: half of the 17."""
_READERS = {".json": ("Audio2Face", read_audio2face), ".anim": ("Unity", read_unity_clip)}


def read_recording(path: Path, angles: str = AUTOMATIC) -> Take:
    """Read a recording of another program, or a table of numbers.

    These are tables of coefficients and of takes, Audio2Face's JSON, Face Cap's text, OpenFace's table and Unity's
    clips. What was assumed is in ``info["notes"]``.

    Parameters
    ----------
    angles : {"automatic", "radians", "degrees"}
        Unit of the rotation of the head in a table of coefficients.

    Raises
    ------
    SourceError
        If the file cannot be read; the message states what is wrong.
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check its name.", path=path)
    program, reader = _READERS.get(path.suffix.lower(), ("", None))
    try:
        if reader is not None:
            return recorded(reader(path), path.name)
        if (found := _other_text(path)) is not None:
            program, performance = found
            return recorded(performance, path.name)
    except (ValueError, OSError, csv.Error) as error:
        raise SourceError(
            "{path} cannot be read as a recording of {program}: {error}.",
            path=path,
            program=program or Message("a program"),
            error=error,
        ) from error
    return from_any_csv(path, angles)


def _other_text(path: Path) -> tuple[str, CoefficientTrack] | None:
    """Return what a text that is no table of coefficients shows, and the program that wrote it; None for a table."""
    if is_face_cap(text := read_decoded(path)):
        return "Face Cap", read_face_cap(text)
    table = read_table(path, OPENFACE_TITLES.__contains__)
    return ("OpenFace", read_openface(table)) if len(OPENFACE_TITLES & set(table.head)) >= _MIN_UNITS else None
