"""Tables of text as programs and spreadsheets write them: any encoding, separator and decimal mark.

Excel saves a table with the separator and the decimal mark of the user's country, or as *Unicode Text*, which is UTF-16
with tabs. Values are passed on as they are, but with decimal points.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks; that of UTF-32 begins like that of UTF-16."""
_SEPARATORS = (",", ";", "\t", "|")
_HINT = re.compile(r"sep=(.)\s*$", re.IGNORECASE)
"""First line by which Excel is told the separator."""
_DECIMAL_COMMA = re.compile(r"^\s*[-+]?\d*,\d+(?:[eE][-+]?\d+)?\s*$")
_MAX_BYTES = 1 << 30


@dataclass(frozen=True)
class TextTable:
    """A table: the titles of its columns, its lines, and the note above the titles, if there is one."""

    head: list[str]
    lines: Iterator[list[str]]
    note: str = ""


def read_table(path: Path, known: Callable[[str], bool], note: str = "") -> TextTable:
    """Open a table of text.

    Parameters
    ----------
    path : Path
    known : callable
        Whether a title is expected; the separator that gives most of these is taken.
    note : str
        Beginning of a line that may precede the titles; "" for none.

    Returns
    -------
    TextTable
        Its lines are read one by one. Empty ones are left out.

    Raises
    ------
    ValueError
        If it is not text, or too large.
    OSError
        If it cannot be read.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"it is larger than {_MAX_BYTES >> 20:,} MB")
    text = StringIO(_decoded(path.read_bytes()), newline="")
    first, separator, noted = text.readline(), "", ""
    if hint := _HINT.match(first):
        separator, first = hint[1], text.readline()
    if note and first.lstrip('"').startswith(note):
        noted, first = next(csv.reader([first]), [""])[0], text.readline()
    separator = separator or max(_SEPARATORS, key=lambda one: _expected(_split(first, one), known))
    lines = _lines(csv.reader(text, delimiter=separator), separator)
    return TextTable([title.strip() for title in _split(first, separator)], lines, noted)


def _split(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator), [])


def _expected(head: list[str], known: Callable[[str], bool]) -> tuple[int, int]:
    """Return how many of the titles are known, and how many there are."""
    return sum(known(title.strip()) for title in head), len(head)


def _decoded(data: bytes) -> str:
    """Decode a text: by its byte order mark, as UTF-8, as UTF-16 without a mark, or in Western Europe's code page."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data.decode(encoding)
    if data[1:2] == b"\0" or data[:1] == b"\0":
        return data.decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def _lines(rows: Iterator[list[str]], separator: str) -> Iterator[list[str]]:
    for row in rows:
        if any(row):
            yield row if separator == "," else [_with_point(cell) for cell in row]


def _with_point(cell: str) -> str:
    """Return a number with a decimal point, and a timecode with one."""
    if _DECIMAL_COMMA.match(cell) or (":" in cell and cell.count(",") == 1):
        return cell.replace(",", ".")
    return cell
