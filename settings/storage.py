"""Default locations of files, next to the .blend file or in folders of the user, and files that were made before it was
saved, which move beside it at its first save.

Blender deletes the extension's own folder when the extension is removed, even to be installed again.

Files of versions that stored them in the extension's folder, which Blender deletes with the extension, move to the
user's folder when this version starts. `MOVED` in that folder lists where each was, so that every .blend file finds
them.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy

from ..blender.messages import show_error
from ..core.errors import Message, OutputError
from ..core.files.reading import as_object, as_text, parse_format, read_text
from ..core.files.writing import check_writable, reason_of, replacing
from .preferences import EXTENSION, preferences

TAKES, CACHES, PRESETS = "takes", "caches", "presets"
MOVED = "moved.json"
"""File in the user's folder: new names of files that were in the extension's folder, by their earlier paths."""
_FORMAT = "facemime-moved-files"
_MAX_PATH = 4096
_OF_LINES = ("path", "video")
"""Properties of a take in the list that refer to files, which is relative in a saved file."""
_session: dict[str, Path] = {}
"""New places of the files that the first save of the open file moved, for the undo steps before it."""

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
    """Return the user's documents folder, or else the home folder, or else the temporary folder."""
    try:
        home = Path.home()
    except RuntimeError:  # neither the environment nor the system knows one
        home = Path(tempfile.gettempdir())
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
    """Return the folder `name` next to the open .blend file, or the default folder if that file has not been saved, or
    nothing can be written there, as next to a file of a read-only library.
    """
    beside_file = Path(bpy.path.abspath(f"//{name}"))
    return beside_file if bpy.data.filepath and _is_writable(beside_file) else default_folder(name)


def _is_writable(folder: Path) -> bool:
    try:
        check_writable(folder / "new")
    except OutputError:
        return False
    return True


def relative(path: Path, blend: str = "") -> str:
    """Return `path` relative to a .blend file, by default the open one, if possible: with slashes on every system."""
    blend = blend or bpy.data.filepath
    if not blend:
        return str(path)
    try:
        return str(bpy.path.relpath(str(path), start=str(Path(blend).parent))).replace(os.sep, "/")
    except ValueError:  # another drive
        return str(path)


def free_path(folder: Path, name: str, suffix: str) -> Path:
    """Return a path that does not exist yet; `name` is the base of the file name, cleaned and numbered as needed."""
    clean = bpy.path.clean_name(name.strip() or "take").strip("_") or "take"
    path, number = folder / f"{clean}{suffix}", 1
    while os.path.lexists(path):
        number += 1
        path = folder / f"{clean} {number}{suffix}"
    return path


def located(path: str) -> Path:
    """Return where the file is to which `path` refers: there, or where it was moved.

    The path is absolute, or relative to the open .blend file.
    """
    there = _absolute(path)
    if os.path.lexists(there):
        return there
    known = _session.get(str(there)) or _read_moved(there.parent.name).get(str(there))
    return known if known is not None and known.exists() else there


def beside(path: Path) -> Path:
    """Move a take that was begun before the first save, with its video, beside the .blend file; return its new path.

    One that is elsewhere, or the take of a file that has not been saved or is in a read-only folder, stays where it is.
    """
    moved = _copied({path}, Path(bpy.data.filepath)) if project_folder(TAKES) != default_folder(TAKES) else {}
    for old in moved:
        with suppress(OSError):  # the copy is what counts
            old.unlink()
    return moved.get(path, path)


def default_folder(name: str) -> Path:
    """Return the folder for takes or caches for which there is no place next to the .blend file."""
    preferred = preferences().takes_folder if name == TAKES else ""
    return Path(bpy.path.abspath(preferred)) if preferred else user_folder(name)


def adopt_earlier_files() -> None:
    """Move takes, caches and presets out of the extension's folder; what cannot be moved stays there."""
    for name, target in ((TAKES, user_folder(TAKES)), (CACHES, user_folder(CACHES)), (PRESETS, presets_folder())):
        earlier = private_folder(name)
        try:
            if earlier.is_dir() and not earlier.is_symlink():
                _adopt(earlier, target, listed=name != PRESETS)
        except (OSError, OutputError) as error:
            _report(earlier, target, error)


def _report(folder: Path, target: Path, error: Exception) -> None:
    reason = reason_of(error) if isinstance(error, OSError) else error
    show_error(
        Message(
            "The files in {folder} cannot be moved to {target} ({reason}). Move them yourself.",
            folder=folder,
            target=target,
            reason=reason,
        )
    )


def _adopt(earlier: Path, target: Path, *, listed: bool) -> None:
    files = _with_companions(earlier, "*")
    if not files:
        return
    new = _places(files, target, f"Blender {bpy.app.version_string}")
    target.mkdir(parents=True, exist_ok=True)
    if listed:  # before anything is moved, so that nothing is lost in between
        known = _read_moved(target.name) | {str(path): place for path, place in new.items()}
        names = {path: place.relative_to(target).as_posix() for path, place in known.items()}
        with replacing(target / MOVED) as temporary:
            temporary.write_text(json.dumps({"format": _FORMAT, "names": names}, indent=1), encoding="utf-8")
    for path, place in new.items():
        place.parent.mkdir(exist_ok=True)
        with suppress(FileNotFoundError):  # another Blender has just moved it
            shutil.move(path, place)
    with suppress(OSError):
        earlier.rmdir()


def _with_companions(folder: Path, stem: str) -> list[Path]:
    """Return the files of a stem in `folder`: a take, its video and its sound."""
    return sorted(path for path in folder.glob("[!.]*") if stem in ("*", path.stem) and path.is_file())


def _places(files: Iterable[Path], target: Path, name: str) -> dict[Path, Path]:
    """Return free paths for `files` in `target`, or all in a new folder `name` in it, as takes name their videos."""
    files, folder = list(files), target
    if any(os.path.lexists(folder / path.name) for path in files):
        folder = free_path(target, name, "")
    return {path: folder / path.name for path in files}


def _read_moved(name: str) -> dict[str, Path]:
    """Return the new places of the files in a folder of the extension, by their earlier paths."""
    folder = user_folder(name)
    try:
        names = as_object(parse_format(read_text(folder / MOVED), _FORMAT).get("names"), "names")
        places = {path: folder / as_text(new, "name", _MAX_PATH) for path, new in names.items()}
        return {path: place for path, place in places.items() if ".." not in place.parts}
    except (OSError, ValueError):  # most users have none
        return {}


def _absolute(path: str) -> Path:
    there = Path(os.path.normpath(bpy.path.abspath(path)))
    if path.startswith("//") and "\\" in path and not os.path.lexists(there):  # saved on Windows by an earlier version
        return Path(os.path.normpath(bpy.path.abspath(path.replace("\\", "/"))))
    return there


class _Saving:
    """A save, until it is known whether it succeeded and whether it was a copy.

    Attributes
    ----------
    before : list of str or None
        What each of `_references`, in its order, referred to before; None if it was not changed. Blender keeps these
        itself, and would load an image again whose path is set, without what was painted on it.
    copies : dict of Path to Path
        Files that were copied beside the .blend file.
    """

    before: list[str | None] = []
    copies: dict[Path, Path] = {}


def _before_saving(filepath: str, *_: object) -> None:
    """Copy the files of an unsaved .blend file beside it, and make the paths of takes relative to it."""
    blend = "" if Path(filepath).parent == Path(bpy.utils.user_resource("CONFIG")) else str(filepath)
    paths = [(owner, name, located(getattr(owner, name))) for owner, name in _references()]
    _Saving.copies = _copied({old for *_, old in paths}, Path(blend)) if blend and not bpy.data.filepath else {}
    _Saving.before = []
    for owner, name, old in paths:
        changes = _is_line(name) or old in _Saving.copies
        _Saving.before.append((str(old) if _is_line(name) else getattr(owner, name)) if changes else None)
        if changes:
            new = _Saving.copies.get(old, old)
            _refer(owner, name, new, blend, str(new))


def _after_saving(*_: object) -> None:
    """Remove what was copied from its earlier place, or refer to it again if a copy was saved, or nothing."""
    if bpy.data.filepath and _Saving.copies:
        _session.update({str(old): new for old, new in _Saving.copies.items()})
        listed = set(_read_moved(TAKES).values()) | set(_read_moved(CACHES).values())
        for old in _Saving.copies.keys() - listed:  # other .blend files may refer to those of an earlier version
            with suppress(OSError):  # the copy is what counts
                old.unlink()
    else:
        for (owner, name), path in zip(_references(), _Saving.before, strict=False):
            if path is not None:
                _refer(owner, name, Path(path), bpy.data.filepath, path)
    _Saving.before, _Saving.copies = [], {}


def _after_undo(*_: object) -> None:
    """Let references of an undo step from before the first save find the files that have moved."""
    for owner, name in _references():
        path = getattr(owner, name)
        if (new := located(path)) != _absolute(path):
            _refer(owner, name, new, bpy.data.filepath, str(new))


def _after_loading(*_: object) -> None:
    _session.clear()
    _after_undo()


def _references() -> Iterator[tuple[Any, str]]:
    """Yield the owner and the name of each property with the path of a take, its video or sound, or a cache."""
    for scene in bpy.data.scenes:
        if scene.library is not None:
            continue
        for line in scene.facemime_takes.items:
            yield from ((line, name) for name in _OF_LINES if getattr(line, name))
        if scene.sequence_editor is not None:
            yield from ((strip, "filepath") for strip in _strips(scene.sequence_editor) if strip.type == "MOVIE")
    for kind in (bpy.data.images, bpy.data.movieclips, bpy.data.sounds):
        for data in kind:
            if data.library is None and data.filepath:
                yield data, "filepath"
    for obj in bpy.data.objects:
        if obj.library is not None:
            continue
        for modifier in obj.modifiers:
            if isinstance(modifier, bpy.types.MeshCacheModifier) and modifier.filepath:
                yield modifier, "filepath"


def _strips(editor: bpy.types.SequenceEditor) -> Iterable[Any]:
    return editor.strips_all if hasattr(editor, "strips_all") else editor.sequences_all  # up to Blender 4.3


def _is_line(name: str) -> bool:
    return name in _OF_LINES


def _refer(owner: Any, name: str, path: Path, blend: str, other: str) -> None:
    """Let a take in the list refer to `path`, relative to the .blend file, and anything else to `other`."""
    text = relative(path, blend) if _is_line(name) and blend else str(path) if _is_line(name) else other
    if getattr(owner, name) != text:
        setattr(owner, name, text)


def _copied(paths: set[Path], blend: Path) -> dict[Path, Path]:
    """Copy those of the files that are in the default folders beside a .blend file; return where each is then."""
    copies: dict[Path, Path] = {}
    for name in (TAKES, CACHES):
        target = blend.parent / name
        folders = {default_folder(name), user_folder(name)} - {target}
        here = {path for path in paths if path.parent in folders and path.is_file()}
        files = {file for path in here for file in _with_companions(path.parent, path.stem)}
        places = _places(sorted(files), target, blend.stem)
        try:
            for old, new in places.items():
                new.parent.mkdir(parents=True, exist_ok=True)
                _copy(old, new)
                copies[old] = new
        except OSError as error:
            _report(old.parent, target, error)
    return copies


def _copy(old: Path, new: Path) -> None:
    try:
        os.link(old, new)  # at once, on the same disk
    except OSError:
        shutil.copy2(old, new)


def register() -> None:
    """Move the files of earlier versions."""
    adopt_earlier_files()


HANDLERS = {
    "save_pre": _before_saving,
    "save_post": _after_saving,
    "save_post_fail": _after_saving,
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "load_post": _after_loading,
}
