"""Files and JSON that others wrote: read within bounds, and whatever is wrong with their form is one `ValueError`."""

from __future__ import annotations

import json
import os
from math import isfinite
from pathlib import Path
from typing import Any

MAX_TEXT = 8 << 20
"""Bytes of a JSON file: eighty times the largest that is written."""
_DIGITS = 18
_PIECE = 1 << 20


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file of at most `most` bytes; ValueError where it has more, OSError where it cannot be read."""
    pieces, length = [], 0
    with open(path, "rb") as stream:
        # As much as it says it has, and not `read(most)`, which would take that memory at once; a pipe says 0.
        wanted = min(os.fstat(stream.fileno()).st_size, most) + 1
        while piece := stream.read(wanted):
            pieces.append(piece)
            length, wanted = length + len(piece), _PIECE
            if length > most:
                raise ValueError(f"it is larger than {most >> 20} MB")
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def read_text(path: Path) -> str:
    """The text of a file in UTF-8; ValueError where it is too large or something else, OSError as for any file."""
    try:
        return read_bytes(path, MAX_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("it is not a text in UTF-8") from error


def parse_json(text: str | bytes, *, nan: bool = False) -> Any:
    """The value of a JSON text.

    Parameters
    ----------
    text : str or bytes
    nan : bool
        Whether numbers may be NaN, as Python writes them though JSON has none. They are never infinite.

    Raises
    ------
    ValueError
        Where it is no JSON, nested too deeply, or has a number that is not finite or too large.
    """
    try:
        return json.loads(text, parse_int=_whole, parse_float=_real, parse_constant=_nan if nan else _refused)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except UnicodeError as error:
        raise ValueError("it is not a text in UTF-8") from error
    except json.JSONDecodeError as error:
        raise ValueError(f"it is not JSON: {error.msg} in line {error.lineno}") from error


def as_number(value: Any, name: str, low: float, high: float) -> float:
    """`value` as a number from `low` to `high`; ValueError where it is something else."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} is {shown(value)}, not a number from {low:g} to {high:g}")
    return float(value)


def as_whole(value: Any, name: str, low: int, high: int) -> int:
    """`value` as a whole number from `low` to `high`; ValueError where it is something else."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} is {shown(value)}, not a whole number from {low} to {high}")
    return value


def as_text(value: Any, name: str, most: int = 200) -> str:
    """`value` as a text of at most `most` letters; ValueError where it is something else."""
    if not isinstance(value, str) or len(value) > most:
        raise ValueError(f"{name} is {shown(value)}, not a text of at most {most} letters")
    if any("\ud800" <= letter <= "\udfff" for letter in value):  # JSON can have them; no file and no Blender takes them
        raise ValueError(f"{name} is {shown(value)}, which has invalid characters")
    return value


def as_list(value: Any, name: str, most: int) -> list[Any]:
    """`value` as a list of at most `most` items; ValueError where it is something else."""
    if not isinstance(value, list) or len(value) > most:
        raise ValueError(f"{name} is {shown(value)}, not a list of at most {most} items")
    return value


def as_object(value: Any, name: str) -> dict[str, Any]:
    """`value` as a JSON object; ValueError where it is something else."""
    if not isinstance(value, dict):
        raise ValueError(f"{name} is {shown(value)}, not an object")
    return value


def shown(value: Any) -> str:
    """`value` for a message, cut where it is long."""
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
