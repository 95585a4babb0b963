"""Presets: reading and writing, which checks them as a whole, their contents, and those that Facemime ships."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..control_points.selection import SelectionSettings
from ..drive.drive_settings import DriveSettings, PosingSettings
from ..errors import DataError, OutputError, SourceError, messages
from ..files.assets import ASSETS
from ..files.reading import as_object, parse_format, read_text, shown
from ..files.setting import Setting, settings_of
from ..tracking.tracker import TrackingSettings
from .puppet_settings import PuppetSettings

SUFFIX = ".json"
_FORMAT = "facemime-preset"


_FORBIDDEN = frozenset('<>:"/\\|?*')
_DEVICES = frozenset({"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))})
"""Names that Windows reserves, whatever the suffix."""
_MAX_NAME = 200
"""Largest length of a name in bytes. With suffix and temporary prefix it fits into the 255 bytes of file systems."""


Settings = Mapping[str, Mapping[str, Setting]]
Values = dict[str, dict[str, Any]]


def to_json(values: Values) -> str:
    """Serialise a preset: the values of its settings, by group."""
    return json.dumps({"format": _FORMAT} | values, indent=2) + "\n"


def from_json(text: str, known: Settings) -> Values:
    """Parse a preset, and return its checked values of the `known` settings by group; others are ignored.

    Raises SourceError if the text is not a preset, or a value is out of its range.
    """
    try:
        data = parse_format(text, _FORMAT)
        if not data.keys() & known.keys():
            raise DataError("it has no settings")
        return {
            group: {name: setting.checked(given[name], name) for name, setting in settings.items() if name in given}
            for group, settings in known.items()
            for given in [as_object(data.get(group, {}), group)]
        }
    except ValueError as error:
        raise SourceError("This is not a Facemime preset ({error}). Choose another file.", error=error) from error


def file_name(name: str) -> str:
    """Return the file name of the preset `name`, which is the same on every system.

    Raises OutputError if no file can have that name.
    """
    clean = name.strip()
    odd = any(letter in _FORBIDDEN or not letter.isprintable() for letter in clean)
    if not clean or odd or clean[0] == "." or clean[-1] == "." or clean.split(".")[0].strip().lower() in _DEVICES:
        raise OutputError(
            "{name} cannot be used as the name of a preset. Use letters, digits and spaces.", name=shown(name)
        )
    if len(clean.encode()) > _MAX_NAME:
        raise OutputError(
            "{name} cannot be used as the name of a preset: it is too long. Use a shorter one.", name=shown(name)
        )
    return clean + SUFFIX


BUILT_IN = messages(
    {"calm_speech": "Calm Speech", "strong": "Strong", "cartoon": "Cartoon", "yao_2019": "Yao et al. 2019"}
)
"""Labels of the shipped presets by file name; these cannot be removed."""
COMMAND_NAMES = {"calm-speech": "calm_speech", "strong": "strong", "cartoon": "cartoon", "paper": "yao_2019"}
"""Names of the shipped presets on the command line."""
CONTENTS: Mapping[str, Mapping[str, Setting]] = {
    "settings": {**settings_of(DriveSettings), **settings_of(PuppetSettings), **settings_of(TrackingSettings)},
    "posing": settings_of(PosingSettings),
    "selection": {"search": settings_of(SelectionSettings)["search"]},
}
"""Settings in a preset, by group."""


def built_in_path(name: str) -> Path:
    """Return the path of a shipped preset, a key of `BUILT_IN`."""
    return ASSETS / "presets" / f"{name}{SUFFIX}"


def read_preset(path: Path) -> Values:
    """Read a preset, and return the values of its settings by group.

    Raises SourceError if the file is missing or not a preset.
    """
    try:
        return from_json(read_text(path), CONTENTS)
    except (OSError, ValueError) as error:
        raise SourceError(
            "{path} is not a valid preset ({error}). Choose another file.", path=path, error=error
        ) from error
    except SourceError as error:
        raise SourceError("{path}: {error}", path=path, error=error) from error
