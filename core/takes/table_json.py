"""Frames in JSON as tables: a value for each name, as BEAT and many scripts write them (takes.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..errors import DataError
from .table_text import TextTable
from .table_times import is_title_of_rate

_LEAST_NAMES = 3
"""Shortest list of texts that are the names of the values in each frame."""
_MAX_TITLES = 1_000
_MAX_DEPTH = 3
_NAME = ("name", "categoryName", "category_name", "key", "k")
_VALUE = ("score", "value", "weight", "v")
"""Keys of the name and the value of a coefficient where each is an object, as from MediaPipe and VTube Studio."""


def table_of_json(data: Any) -> TextTable:
    """Return the frames of parsed JSON as a table; ValueError if it has none.

    These are a list of objects or of lists of numbers, by itself or within an object. Values have names by themselves,
    or are as many as the texts of a list beside the frames.
    """
    frames, names, rates = data, [], {}
    if isinstance(data, dict):
        lists = [value for value in data.values() if isinstance(value, list) and value]
        names = next((value for value in lists if len(value) >= _LEAST_NAMES and _are(value, str)), [])
        frames = next((value for value in lists if _are(value, dict) or _are(value, list)), [])
        rates = {title: str(value) for title, value in data.items() if is_title_of_rate(title) and _is_number(value)}
    if not isinstance(frames, list) or not frames:
        raise DataError("it has no list of frames")
    rows = [rates | dict(_cells(frame, "", names)) for frame in frames]
    head = list(dict.fromkeys(title for row in rows for title in row))
    if len(head) > _MAX_TITLES:
        raise DataError("its frames have more than {titles:,} names", titles=_MAX_TITLES)
    return TextTable(head, ([row.get(title, "") for title in head] for row in rows))


def _cells(value: Any, title: str, names: list[str], depth: int = 0) -> Iterator[tuple[str, str]]:
    """Yield the titles and the numbers or texts of a frame."""
    if depth > _MAX_DEPTH:
        return
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _cells(item, f"{title}.{key}" if title else key, names, depth + 1)
    elif isinstance(value, list):
        if value and len(value) == len(names) and all(map(_is_number, value)):
            yield from ((name, str(number)) for name, number in zip(names, value, strict=True))
        for item in value:
            if isinstance(item, dict) and (name := _first(item, _NAME)) is not None:
                yield str(name), str(_first(item, _VALUE))
    elif _is_number(value) or isinstance(value, str):
        yield title, str(value)


def _first(item: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    return next((item[key] for key in keys if key in item), None)


def _are(values: list[Any], kind: type) -> bool:
    return all(isinstance(value, kind) for value in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
