"""Tables of text as programs and spreadsheets write them: any encoding, separator and decimal mark.

Excel saves a table with the separator and the decimal mark of the user's country, or as *Unicode Text*, which is UTF-16
with tabs. Values are passed on as they are, but with decimal points.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO
from itertools import chain, islice
from pathlib import Path
from typing import TypeVar

from ..errors import DataError, Message

_Parsed = TypeVar("_Parsed")

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks; that of UTF-32 begins like that of UTF-16."""
SUFFIXES = (".csv", ".tsv", ".txt")
"""Suffixes of tables: Excel's *Unicode Text* is .txt."""
_SEPARATORS = (",", ";", "\t", "|")
_HINT = re.compile(r"\"?sep=(.)\"?\s*$", re.IGNORECASE)
"""First line that tells Excel which separator the file uses."""
_COMMENT = ("#", "//")
_MOST_ABOVE = 50
"""Most lines above the titles: names of programs, takes and performers, and comments."""
_DECIMAL_COMMA = re.compile(r"^\s*[-+]?\d*,\d+(?:[eE][-+]?\d+)?\s*$")
_GROUPED = re.compile(r"^\s*[-+]?\d{1,3}(?:(?:,\d{3})+\.\d*|(?:,\d{3}){2,}|(?:\.\d{3})+,\d*)\s*$")
"""Number whose thousands are separated: 1,234.5 or 1.234,5."""
_MAX_BYTES = 1 << 30
_MAX_ROWS = 1_000_000
_LEAST_ROWS = 4
"""Rows from which a last one that cannot be read may be left out: a table of a few rows is refused instead."""


@dataclass(frozen=True)
class TextTable:
    """A table: the titles of its columns, its lines, also those that repeat them, and the note above, if any."""

    head: list[str]
    lines: Iterator[list[str]]
    note: str = ""


def read_table(path: Path, known: Callable[[str], bool], note: str = "") -> TextTable:
    """Open a table of text, whose lines are read one by one; empty ones are left out.

    The separator that gives most titles that are `known` is taken; a line that begins with `note` may precede them.
    Raises ValueError if it is not text, or too large, and OSError if it cannot be read.
    """
    text = StringIO(read_decoded(path), newline="")
    above = [text.readline() for _ in range(_MOST_ABOVE)]
    separator = hint[1] if (hint := _HINT.match(above[0])) else ""
    choices = [(number, one) for number in range(_MOST_ABOVE) for one in separator or _SEPARATORS]
    number, separator = max(choices, key=lambda choice: _expected(_split(above[choice[0]], choice[1]), known))
    noted = [next(csv.reader([line])) for line in above[:number] if note and line.lstrip('"').startswith(note)]
    rows = csv.reader(chain(above[number + 1 :], text), delimiter=separator)
    head = [title.strip() for title in _split(above[number], separator)]
    return TextTable(head, _lines(rows, head), noted[0][0] if noted else "")


def parse_rows(table: TextTable, parse: Callable[[list[list[str]]], _Parsed]) -> tuple[_Parsed, list[str]]:
    """Return what `parse` makes of the rows of a table, and what was left out of them.

    These are rows that repeat the titles, and a last one that was cut short, as by a power failure: it has fewer cells
    than any other, or only the others can be parsed. Raises ValueError if there are no rows, or too many.
    """
    every = list(islice(table.lines, _MAX_ROWS + 1))
    if len(every) > _MAX_ROWS:
        raise DataError("it has more than {max_rows:,} rows", max_rows=_MAX_ROWS)
    rows = [row for row in every if row[: len(table.head)] != table.head]
    if not rows:
        raise DataError("it has no rows")
    notes: list[str] = []
    if count := len(every) - len(rows):
        notes.append(Message("Rows that repeat the titles were left out: {count}.", count=count))
    cut = [*notes, Message("The last row was cut short and was left out.")]
    if len(rows) > 1 and len(rows[-1]) < min(map(len, rows[:-1])):
        return parse(rows[:-1]), cut
    try:
        return parse(rows), notes
    except ValueError as error:
        if len(rows) >= _LEAST_ROWS:
            with suppress(ValueError):
                return parse(rows[:-1]), cut
        raise error


def read_decoded(path: Path) -> str:
    """Read a text in any usual encoding; ValueError if it is too large or not text, OSError if it cannot be read.

    Zeros at the end, which a power failure leaves, become a single one: its row cannot be read.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise DataError("it is larger than {max_bytes:,} MB", max_bytes=_MAX_BYTES >> 20)
    try:
        text = _decoded(path.read_bytes())
    except UnicodeDecodeError as error:
        raise DataError("it is not text") from error
    return text.rstrip("\0") + "\0" if text.endswith("\0") else text


def _split(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator), [])


def _expected(head: list[str], known: Callable[[str], bool]) -> tuple[int, int]:
    """Return how many of the titles are known, and, if any is, how many there are."""
    count = sum(known(title.strip()) for title in head)
    return count, len(head) if count else 0


def _decoded(data: bytes) -> str:
    """Decode a text: by its byte order mark, as UTF-8, as UTF-16 without a mark, or in Western Europe's code page."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            width = int(encoding[4:]) // 8 if mark != codecs.BOM_UTF8 else 1
            return data[: len(data) // width * width].decode(encoding)
    if data[1:2] == b"\0" or data[:1] == b"\0":
        return data[: len(data) // 2 * 2].decode("utf-16-le" if data[1:2] == b"\0" else "utf-16-be")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def _lines(rows: Iterator[list[str]], head: list[str]) -> Iterator[list[str]]:
    """Yield rows with decimal points, without empty ones, comments and a row of units below titles."""
    above = True
    for row in rows:
        cells = [cell.strip() for cell in row]
        repeats = cells[: len(head)] == head
        if not any(cells) or cells[0].startswith(_COMMENT) or (above and not repeats and _is_of_units(cells)):
            continue
        above = repeats
        yield cells if repeats else [_with_point(cell) for cell in cells]


def _is_of_units(cells: list[str]) -> bool:
    """Return whether cells are units or ranges of values, such as s, - and (0-1): none is a number or a timecode."""
    return not any(is_number(_with_point(cell)) or ":" in cell for cell in cells)


def is_number(text: str) -> bool:
    """Return whether a cell is a number, possibly NaN."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _with_point(cell: str) -> str:
    """Return a number with a decimal point and without separators of thousands, and a timecode with a point."""
    if _GROUPED.match(cell):
        last = max(cell.rfind(","), cell.rfind(".")) if "." in cell else len(cell)
        return re.sub(r"[,.]", "", cell[:last]) + "." + cell[last + 1 :]
    if _DECIMAL_COMMA.match(cell) or (":" in cell and cell.count(",") == 1):
        return cell.replace(",", ".")
    return cell
