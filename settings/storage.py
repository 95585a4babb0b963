"""Default locations of files: next to the .blend file, or in the user's folder."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

EXTENSION = __package__.rpartition(".")[0]
"""Name by which Blender knows the extension."""


def user_folder(name: str) -> Path:
    """Return the user's folder `name` for the extension, which is kept when it is updated."""
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION, path=name))
    except ValueError:  # running from the source tree, not as an installed extension
        return Path(bpy.utils.user_resource("CONFIG", path=f"facemime/{name}"))


def project_folder(name: str) -> Path:
    """Return the folder `name` next to the open .blend file, or the user's folder if it has not been saved."""
    return Path(bpy.path.abspath(f"//{name}")) if bpy.data.filepath else user_folder(name)


def relative(path: Path, blend: str = "") -> str:
    """Return `path` relative to a .blend file if possible.

    Parameters
    ----------
    path : Path
    blend : str
        Path of the .blend file; "" is the open one.
    """
    blend = blend or bpy.data.filepath
    if not blend:
        return str(path)
    try:
        return str(bpy.path.relpath(str(path), start=str(Path(blend).parent)))
    except ValueError:  # another drive
        return str(path)


def free_path(folder: Path, name: str, suffix: str) -> Path:
    """Return a path that does not exist yet.

    Parameters
    ----------
    folder : Path
    name : str
        Base of the file name, which is cleaned and numbered as needed.
    suffix : str
        Such as ".facetake".
    """
    clean = bpy.path.clean_name(name.strip() or "take").strip("_") or "take"
    path, number = folder / f"{clean}{suffix}", 1
    while os.path.lexists(path):
        number += 1
        path = folder / f"{clean} {number}{suffix}"
    return path
