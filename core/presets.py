"""Presets as text: checked as a whole before anything is set by one, and the names that their files may have."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from .errors import OutputError, SourceError
from .reading import as_object, parse_json, shown
from .settings import Setting

SUFFIX = ".json"
_FORMAT = "facemime-preset"
_FORBIDDEN = frozenset('<>:"/\\|?*')
_DEVICES = frozenset({"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))})
"""Names that Windows keeps for itself, whatever follows a dot behind them."""
_LONGEST_NAME = 200
"""Bytes: with the suffix, and what a file is called while it is written, they fit into the 255 of file systems."""


Settings = Mapping[str, Mapping[str, Setting]]
Values = dict[str, dict[str, Any]]


def to_json(values: Values) -> str:
    """The text of a preset: the values of the settings of each group."""
    return json.dumps({"format": _FORMAT} | values, indent=2) + "\n"


def from_json(text: str, known: Settings) -> Values:
    """The values that a preset has for the `known` settings of each group, all of them checked; others are left out.

    Raises
    ------
    SourceError
        Where the text is not a preset, or a value is not one that its setting can have.
    """
    try:
        data = as_object(parse_json(text), "the text")
        if data.get("format") != _FORMAT:
            raise ValueError("it is not a preset of Facemime")
        return {
            group: {name: setting.checked(given[name], name) for name, setting in settings.items() if name in given}
            for group, settings in known.items()
            for given in [as_object(data.get(group), group)]
        }
    except ValueError as error:
        raise SourceError(f"This is not a preset that can be read ({error}). Choose another file.") from error


def file_name(name: str) -> str:
    """The name of the file of the preset `name`, the same on every system.

    Raises
    ------
    OutputError
        Where it cannot be a file's name.
    """
    clean = name.strip()
    odd = any(letter in _FORBIDDEN or not letter.isprintable() for letter in clean)
    if not clean or odd or clean[0] == "." or clean[-1] == "." or clean.split(".")[0].strip().lower() in _DEVICES:
        raise OutputError(f"{shown(name)} cannot be the name of a preset. Use letters, digits and spaces.")
    if len(clean.encode()) > _LONGEST_NAME:
        raise OutputError(f"{shown(name)} cannot be the name of a preset: it is too long. Use fewer letters.")
    return clean + SUFFIX
