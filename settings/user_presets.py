"""Presets: settings of a performance in JSON files that users save, load and share."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.errors import OutputError
from ..core.files.writing import reason_of, replacing
from ..core.puppet.presets import CONTENTS, SUFFIX, file_name, read_preset, to_json
from .properties import FacemimeSettings
from .storage import presets_folder


def folder() -> Path:
    """Return the folder of the user's presets."""
    return presets_folder()


def names() -> list[str]:
    """Return the names of all presets, sorted."""
    return sorted((path.stem for path in folder().glob(f"[!.]*{SUFFIX}")), key=str.casefold)


def path_of(name: str) -> Path:
    """Return the path of the preset `name`, whether it exists or not; raises OutputError as `file_name` does."""
    return folder() / file_name(name)


def save(settings: FacemimeSettings, path: Path) -> None:
    """Write the settings of a scene to the file of a preset; raises OutputError if it cannot be written."""
    owners = _owners(settings)
    values = {group: {name: getattr(owners[group], name) for name in names} for group, names in CONTENTS.items()}
    with replacing(path) as temporary:
        temporary.write_text(to_json(values), encoding="utf-8")


def load(settings: FacemimeSettings, path: Path) -> None:
    """Apply the preset at `path` to the settings of a scene; those that it does not contain are left unchanged.

    Raises SourceError if the file is missing or not a preset. No setting is changed in that case.
    """
    owners = _owners(settings)
    values = read_preset(path)
    for group, chosen in values.items():
        for name, value in chosen.items():
            setattr(owners[group], name, value)


def remove(name: str) -> None:
    """Remove the preset `name`, if it exists.

    Raises OutputError if the name cannot be a file name, or the file cannot be removed.
    """
    path = path_of(name)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            "Cannot remove {path}: {reason}. Remove it manually.", path=path, reason=reason_of(error)
        ) from error


def _owners(settings: FacemimeSettings) -> dict[str, bpy.types.PropertyGroup]:
    scene = settings.id_data
    assert isinstance(scene, bpy.types.Scene)
    return {"settings": settings, "posing": settings.posing, "selection": scene.facemime_steps}
