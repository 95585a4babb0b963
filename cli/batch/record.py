"""Checks of a clip's record, as others may write to the output folder, and the report shows it."""

from __future__ import annotations

import base64
import binascii
from pathlib import PurePath
from typing import Any

from ...core.errors import DataError
from ...core.files.reading import as_integer, as_list, as_number, as_object, shown

_MOST_FRAMES = 2**31
_MOST_SECONDS = 1e9
_MOST_OUTPUTS = 16
_MOST_POINTS = 1000
"""Largest number of points of the confidence curve."""
_MOST_PICTURES = 16
_MOST_CHARACTERS = 1000
"""Largest number of characters of the text that says what is missing."""


def checked_record(data: Any) -> dict[str, Any]:
    """Check a record, and drop unknown entries.

    Raises
    ------
    ValueError
        If an entry is missing or of another kind.
    """
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
    pictures = as_list(given.get("thumbnails"), "thumbnails", _MOST_PICTURES)
    record["thumbnails"] = [_picture(text) for text in pictures]
    return record


def _name(value: Any) -> str:
    """The name of a file; not a path, which might lead anywhere."""
    if not isinstance(value, str) or value in ("", ".", "..") or PurePath(value).name != value or "\\" in value:
        raise DataError("{value} is not the name of a file", value=shown(value))
    return value


def _picture(value: Any) -> str:
    if not isinstance(value, str):
        raise DataError("{value} is not a picture", value=shown(value))
    try:
        base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise DataError("a thumbnail is not in base 64") from error
    return value
