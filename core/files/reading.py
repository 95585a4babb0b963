"""Reading of untrusted files and JSON within bounds; every fault in their content is a `ValueError`."""

from __future__ import annotations

import json
import os
from math import isfinite
from pathlib import Path
from typing import Any

from ..errors import DataError

MAX_TEXT = 8 << 20
"""Largest size of a JSON file in bytes: eighty times the largest that is written."""
_DIGITS = 18
_PIECE = 1 << 20


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a file; raises ValueError if it exceeds `limit` bytes, and OSError if it cannot be read."""
    pieces, length = [], 0
    with open(path, "rb") as stream:
        # Not `read(limit)`, which would allocate that memory at once; the stated size of a pipe is 0.
        wanted = min(os.fstat(stream.fileno()).st_size, limit) + 1
        while piece := stream.read(wanted):
            pieces.append(piece)
            length, wanted = length + len(piece), _PIECE
            if length > limit:
                raise DataError("it is larger than {limit} MB", limit=limit >> 20)
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def read_text(path: Path) -> str:
    """Read a text file; ValueError if it is too large or not UTF-8, OSError if it cannot be read."""
    try:
        return read_bytes(path, MAX_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError("it is not UTF-8 text") from error


def parse_json(text: str | bytes, *, nan: bool = False) -> Any:
    """Parse JSON; if `nan` is set, numbers may be NaN, which JSON does not have but Python writes.

    Raises ValueError if it is not JSON, is nested too deeply, or contains a number that is too large or infinite.
    """
    try:
        return json.loads(text, parse_int=_whole, parse_float=_real, parse_constant=_nan if nan else _refused)
    except RecursionError as error:
        raise DataError("it is nested too deeply") from error
    except UnicodeError as error:
        raise DataError("it is not UTF-8 text") from error
    except json.JSONDecodeError as error:
        raise DataError("it is not JSON: {problem} in line {line}", problem=error.msg, line=error.lineno) from error


def parse_format(text: str | bytes, form: str, *, nan: bool = False) -> dict[str, Any]:
    """Parse a JSON object whose member "format" is `form`, as `parse_json` does; raises ValueError otherwise."""
    data = as_object(parse_json(text, nan=nan), "the text")
    if data.get("format") != form:
        raise DataError("its format is different")
    return data


def as_number(value: Any, name: str, low: float, high: float) -> float:
    """Return `value` if it is a number from `low` to `high`; raises ValueError, with `name`, if not."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise DataError(
            "{name} is {value}, not a number from {low:g} to {high:g}",
            name=name,
            value=shown(value),
            low=low,
            high=high,
        )
    return float(value)


def as_integer(value: Any, name: str, low: int, high: int) -> int:
    """Return `value` if it is a whole number from `low` to `high`; raises ValueError, with `name`, if not."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise DataError(
            "{name} is {value}, not a whole number from {low} to {high}",
            name=name,
            value=shown(value),
            low=low,
            high=high,
        )
    return value


def as_text(value: Any, name: str, limit: int = 200) -> str:
    """Return `value` if it is a text of at most `limit` characters without unpaired surrogates.

    Raises ValueError, with `name`, if not.
    """
    if not isinstance(value, str) or len(value) > limit:
        raise DataError(
            "{name} is {value}, not a text of at most {limit} characters", name=name, value=shown(value), limit=limit
        )
    if any("\ud800" <= letter <= "\udfff" for letter in value):  # valid in JSON, but neither in files nor in Blender
        raise DataError("{name} is {value}, which has invalid characters", name=name, value=shown(value))
    return value


def as_list(value: Any, name: str, limit: int) -> list[Any]:
    """Return `value` if it is a list of at most `limit` items; raises ValueError, with `name`, if not."""
    if not isinstance(value, list) or len(value) > limit:
        raise DataError(
            "{name} is {value}, not a list of at most {limit} items", name=name, value=shown(value), limit=limit
        )
    return value


def as_object(value: Any, name: str) -> dict[str, Any]:
    """Return `value` if it is a JSON object; raises ValueError, with `name`, if not."""
    if not isinstance(value, dict):
        raise DataError("{name} is {value}, not an object", name=name, value=shown(value))
    return value


def shown(value: Any) -> str:
    """Return the representation of `value` for a message, shortened if long."""
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _whole(digits: str) -> int:
    if len(digits) > _DIGITS:
        raise DataError("{digits}... is too large a number", digits=digits[:12])
    return int(digits)


def _real(digits: str) -> float:
    if not isfinite(value := float(digits)):
        raise DataError("{digits} is too large a number", digits=digits[:12])
    return value


def _nan(name: str) -> float:
    return float("nan") if name == "NaN" else _refused(name)


def _refused(name: str) -> Any:
    raise DataError("{name} is not a number", name=name)
