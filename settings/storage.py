"""Default locations of files: next to the .blend file, or in folders of the user's that outlive the extension.

Blender deletes the extension's own folder when the extension is removed, even to be installed again.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from contextlib import suppress
from pathlib import Path

import bpy

EXTENSION = __package__.rpartition(".")[0]
"""Name by which Blender knows the extension."""
NAME = "Facemime"
"""Folder in the user's documents."""
_CSIDL_PERSONAL = 5
"""Windows' number of the documents folder, which may be on another drive or in OneDrive."""
_XDG = re.compile(r'^XDG_DOCUMENTS_DIR="(?:\$HOME/)?(.+)"$', re.MULTILINE)


def private_folder(name: str) -> Path:
    """Return the extension's own folder `name`, which is kept by updates and deleted with the extension."""
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION, path=name))
    except ValueError:  # running from the source tree, not as an installed extension
        return Path(bpy.utils.user_resource("CONFIG", path=f"facemime/{name}"))


def presets_folder() -> Path:
    """Return the folder of the user's presets: that of Blender's own operators, which outlives extensions."""
    return Path(bpy.utils.user_resource("SCRIPTS", path="presets/facemime"))


def documents() -> Path:
    """Return the user's documents folder, or the home folder if there is none."""
    home = Path.home()
    if sys.platform == "win32":
        buffer = ctypes.create_unicode_buffer(260)
        ctypes.windll.shell32.SHGetFolderPathW(None, _CSIDL_PERSONAL, None, 0, buffer)
        folder = Path(buffer.value) if buffer.value else home / "Documents"
    else:
        folder = home / "Documents"
        with suppress(OSError, UnicodeDecodeError):  # the file exists on Linux desktops only
            chosen = _XDG.search((home / ".config" / "user-dirs.dirs").read_text(encoding="utf-8"))
            folder = home / chosen[1] if chosen else folder
    return folder if folder.is_dir() else home


def user_folder(name: str) -> Path:
    """Return the folder `name` for what is made before the .blend file is first saved."""
    return documents() / NAME / name


def project_folder(name: str) -> Path:
    """Return the folder `name` next to the open .blend file, or the user's folder if it has not been saved."""
    return Path(bpy.path.abspath(f"//{name}")) if bpy.data.filepath else user_folder(name)


def relative(path: Path, blend: str = "") -> str:
    """Return `path` relative to a .blend file if possible.

    Parameters
    ----------
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
