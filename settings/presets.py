"""Presets: how a performance moves a head, kept as JSON files that users save, choose and share."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.drive.settings import DriveSettings, PosingSettings
from ..core.errors import OutputError, SourceError
from ..core.files import replacing
from ..core.presets import SUFFIX, file_name, from_json, to_json
from ..core.puppet.settings import PuppetSettings
from ..core.reading import read_text
from ..core.settings import settings_of
from .properties import FacemimeSettings
from .storage import user_folder

_KNOWN = {
    "settings": {**settings_of(DriveSettings), **settings_of(PuppetSettings)},
    "posing": settings_of(PosingSettings),
}
"""What a preset holds."""


def folder() -> Path:
    """Where the user's presets lie."""
    return user_folder("presets")


def names() -> list[str]:
    """The presets that there are, in the order of their names."""
    return sorted((path.stem for path in folder().glob(f"[!.]*{SUFFIX}")), key=str.casefold)


def path_of(name: str) -> Path:
    """Where the preset `name` lies or would lie.

    Raises
    ------
    OutputError
        For a name that cannot be a file's.
    """
    return folder() / file_name(name)


def save(settings: FacemimeSettings, path: Path) -> None:
    """Write the settings to `path`; OutputError where that fails."""
    owners = _owners(settings)
    values = {group: {name: getattr(owners[group], name) for name in names} for group, names in _KNOWN.items()}
    with replacing(path) as temporary:
        temporary.write_text(to_json(values), encoding="utf-8")


def load(settings: FacemimeSettings, path: Path) -> None:
    """Set the settings to those in `path`; what the file does not name stays.

    Raises
    ------
    SourceError
        Where the file is missing or no preset. No setting has changed then.
    """
    owners = _owners(settings)
    try:
        values = from_json(read_text(path), _KNOWN)
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} is not a preset that can be read ({error}). Choose another file.") from error
    except SourceError as error:
        raise SourceError(f"{path}: {error}") from error
    for group, chosen in values.items():
        for name, value in chosen.items():
            setattr(owners[group], name, value)


def remove(name: str) -> None:
    """Remove the preset `name`, if it exists.

    Raises
    ------
    OutputError
        Where it cannot be a preset's name, or the file cannot be removed.
    """
    path = path_of(name)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputError(f"{path} cannot be removed: {reason}. Remove it by hand.") from error


def _owners(settings: FacemimeSettings) -> dict[str, bpy.types.PropertyGroup]:
    return {"settings": settings, "posing": settings.posing}
