"""Where files of the user's go that nobody named: beside the .blend, or into the user's own folder."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

EXTENSION = __package__.rpartition(".")[0]
"""What Blender knows the extension by."""


def user_folder(name: str) -> Path:
    """The folder `name` of the extension, which outlives files and versions."""
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION, path=name))
    except ValueError:  # run from the source tree, not as an installed extension
        return Path(bpy.utils.user_resource("CONFIG", path=f"facemime/{name}"))


def project_folder(name: str) -> Path:
    """The folder `name` beside the open .blend; that of the user while the file has no name."""
    return Path(bpy.path.abspath(f"//{name}")) if bpy.data.filepath else user_folder(name)


def relative(path: Path, blend: str = "") -> str:
    """`path` as it is kept in the file `blend`, by default the open one: relative to it where that is possible."""
    blend = blend or bpy.data.filepath
    if not blend:
        return str(path)
    try:
        return str(bpy.path.relpath(str(path), start=str(Path(blend).parent)))
    except ValueError:  # another drive
        return str(path)


def free_path(folder: Path, name: str, suffix: str) -> Path:
    """A path in `folder` that does not exist yet, after `name`."""
    clean = bpy.path.clean_name(name.strip() or "take").strip("_") or "take"
    path, number = folder / f"{clean}{suffix}", 1
    while os.path.lexists(path):
        number += 1
        path = folder / f"{clean} {number}{suffix}"
    return path
