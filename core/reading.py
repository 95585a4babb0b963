"""Safe reading of untrusted files and JSON: within bounds, and every problem of their form is a `ValueError`."""

from __future__ import annotations

import json
import os
from math import isfinite
from pathlib import Path
from typing import Any

MAX_TEXT = 8 << 20
"""Upper bound of a JSON file in bytes: eighty times the largest that is written."""
_DIGITS = 18
_PIECE = 1 << 20


def read_bytes(path: Path, most: int) -> bytes:
    """Return the content of a file of limited size.

    Parameters
    ----------
    path : Path
    most : int
        Largest size in bytes.

    Raises
    ------
    ValueError
        If it is larger.
    OSError
        If it cannot be read.
    """
    pieces, length = [], 0
    with open(path, "rb") as stream:
        # Not `read(most)`, which would allocate that memory at once; the stated size of a pipe is 0.
        wanted = min(os.fstat(stream.fileno()).st_size, most) + 1
        while piece := stream.read(wanted):
            pieces.append(piece)
            length, wanted = length + len(piece), _PIECE
            if length > most:
                raise ValueError(f"it is larger than {most >> 20} MB")
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def read_text(path: Path) -> str:
    """Read a text file; ValueError if it is too large or not UTF-8, OSError if it cannot be read."""
    try:
        return read_bytes(path, MAX_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8 text") from error


def parse_json(text: str | bytes, *, nan: bool = False) -> Any:
    """Parse JSON.

    Parameters
    ----------
    text : str or bytes
        The text.
    nan : bool
        Whether numbers may be NaN, which Python writes though JSON has none.

    Returns
    -------
    object
        The value.

    Raises
    ------
    ValueError
        If it is not JSON, is nested too deeply, or has a number that is too large or infinite.
    """
    try:
        return json.loads(text, parse_int=_whole, parse_float=_real, parse_constant=_nan if nan else _refused)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except UnicodeError as error:
        raise ValueError("it is not UTF-8 text") from error
    except json.JSONDecodeError as error:
        raise ValueError(f"it is not JSON: {error.msg} in line {error.lineno}") from error


def as_number(value: Any, name: str, low: float, high: float) -> float:
    """Check that a value is a number within a range.

    Parameters
    ----------
    value : object
        The value.
    name : str
        Its name, for messages.
    low, high : float
        Range, both included.

    Returns
    -------
    float
        The number.

    Raises
    ------
    ValueError
        If it is anything else.
    """
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} is {shown(value)}, not a number from {low:g} to {high:g}")
    return float(value)


def as_whole(value: Any, name: str, low: int, high: int) -> int:
    """As `as_number`, for an integer."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} is {shown(value)}, not a whole number from {low} to {high}")
    return value


def as_text(value: Any, name: str, most: int = 200) -> str:
    """As `as_number`, for a text of at most `most` characters."""
    if not isinstance(value, str) or len(value) > most:
        raise ValueError(f"{name} is {shown(value)}, not a text of at most {most} letters")
    if any("\ud800" <= letter <= "\udfff" for letter in value):  # valid in JSON, but not in files or in Blender
        raise ValueError(f"{name} is {shown(value)}, which has invalid characters")
    return value


def as_list(value: Any, name: str, most: int) -> list[Any]:
    """As `as_number`, for a list of at most `most` items."""
    if not isinstance(value, list) or len(value) > most:
        raise ValueError(f"{name} is {shown(value)}, not a list of at most {most} items")
    return value


def as_object(value: Any, name: str) -> dict[str, Any]:
    """As `as_number`, for a JSON object."""
    if not isinstance(value, dict):
        raise ValueError(f"{name} is {shown(value)}, not an object")
    return value


def shown(value: Any) -> str:
    """Representation of `value` for a message, shortened if long."""
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _whole(digits: str) -> int:
    if len(digits) > _DIGITS:
        raise ValueError(f"{digits[:12]}... is too large a number")
    return int(digits)


def _real(digits: str) -> float:
    if not isfinite(value := float(digits)):
        raise ValueError(f"{digits[:12]} is too large a number")
    return value


def _nan(name: str) -> float:
    return float("nan") if name == "NaN" else _refused(name)


def _refused(name: str) -> Any:
    raise ValueError(f"{name} is not a number")
