"""Presets: how a performance moves a head, kept as JSON files that users save, choose and share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy

from ..core.errors import OutputError, SourceError
from ..core.files import replacing
from .properties import FacemimePosing, FacemimeSettings
from .storage import user_folder

SUFFIX = ".json"
_FORMAT = "facemime-preset"
_SETTINGS = (
    *("mode", "kernel", "strength_upper", "strength_middle", "strength_lower", "smoothing", "mirror"),
    *("rotation", "translation"),
)
_POSING = (
    *("rotation_strength", "rotation_limit", "location_strength", "location_limit", "eyes_strength", "eyes_limit"),
)


def folder() -> Path:
    """Where the user's presets lie."""
    return user_folder("presets")


def names() -> list[str]:
    """The presets that there are, in the order of their names."""
    return sorted((path.stem for path in folder().glob(f"*{SUFFIX}")), key=str.casefold)


def path_of(name: str) -> Path:
    """Where the preset `name` lies or would lie.

    Raises
    ------
    OutputError
        For a name that cannot be a file's.
    """
    clean = name.strip()
    if not clean or clean.startswith(".") or any(letter in '<>:"/\\|?*' or ord(letter) < 32 for letter in clean):
        raise OutputError(f"{name!r} cannot be the name of a preset. Use letters, digits and spaces.")
    return folder() / f"{clean}{SUFFIX}"


def save(settings: FacemimeSettings, path: Path) -> None:
    """Write the settings to `path`; OutputError where that fails."""
    posing: FacemimePosing = settings.posing
    data = {
        "format": _FORMAT,
        "settings": {name: getattr(settings, name) for name in _SETTINGS},
        "posing": {name: getattr(posing, name) for name in _POSING},
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def load(settings: FacemimeSettings, path: Path) -> None:
    """Set the settings to those in `path`; what the file does not name stays.

    Raises
    ------
    SourceError
        Where the file is missing or no preset. No setting has changed then.
    """
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if data.get("format") != _FORMAT:
            raise ValueError("it is not a preset of Facemime")
        chosen = [(settings, name, data["settings"]) for name in _SETTINGS]
        chosen += [(settings.posing, name, data["posing"]) for name in _POSING]
        values = [(owner, name, _checked(owner, name, given[name])) for owner, name, given in chosen if name in given]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise SourceError(f"{path} is not a preset that can be read ({error}). Choose another file.") from error
    for owner, name, value in values:
        setattr(owner, name, value)


def _checked(owner: bpy.types.PropertyGroup, name: str, value: Any) -> Any:
    """`value` as it may be assigned; ValueError where it may not."""
    rna = owner.bl_rna.properties[name]
    kinds: dict[str, type | tuple[type, ...]] = {"FLOAT": (int, float), "BOOLEAN": bool, "ENUM": str}
    if not isinstance(value, kinds[rna.type]) or (rna.type == "FLOAT" and isinstance(value, bool)):
        raise ValueError(f"{name} is {value!r}")
    if rna.type == "ENUM" and value not in rna.enum_items:
        raise ValueError(f"{name} is {value!r}")
    return value
