"""Storage of a scene's takes. The file of a take is never overwritten or deleted."""

from __future__ import annotations

import base64
import binascii
import json
import os
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import bpy

from ..blender.viewports import redraw
from ..core.errors import FacemimeError, SourceError
from ..core.files.assets import SAMPLE
from ..core.files.reading import as_object, parse_json
from ..core.takes.file import SUFFIX, append_pins, load_take, pins_content, save_take, take_of
from ..core.takes.format import NewerFormatError
from ..core.takes.learnt import corrected
from ..core.takes.pins import LEARN, PINS, pins_of
from ..core.takes.take import Take
from .performers import read_learnt
from .storage import TAKES, default_folder, free_path, located, project_folder, relative
from .takes_properties import FacemimeTake

SOUNDS = (".wav", ".flac", ".mp3", ".ogg")


class MisnamedError(SourceError):
    """Raised if Blender cannot store the name of a take."""


def folder() -> Path:
    """Return the folder for new takes: `takes` next to a saved .blend file, otherwise that of the preferences."""
    return project_folder(TAKES)


def chosen(scene: bpy.types.Scene) -> FacemimeTake:
    """Return the take selected in the list; raises FacemimeError if there is none."""
    return at(scene, scene.facemime_takes.index)


def at(scene: bpy.types.Scene, place: int) -> FacemimeTake:
    """Return the take at the given index of the list; raises FacemimeError if the list has no such entry."""
    takes = scene.facemime_takes.items
    if not 0 <= place < len(takes):
        raise FacemimeError("No take is selected. Record or import one.")
    return takes[place]


def new_path(name: str) -> Path:
    """Return a path for a new take, which does not exist yet."""
    return free_path(folder(), name, SUFFIX)


def add(scene: bpy.types.Scene, path: Path, take: Take | None = None) -> FacemimeTake:
    """Add a take to the list and select it; by default its contents are read from the file.

    Raises SourceError if the file cannot be read, or its name cannot be stored by Blender.
    """
    _require_listable(path)
    take = load_take(path) if take is None else take
    takes = scene.facemime_takes
    line = takes.items.add()
    line.name, line.path = path.stem, relative(path)
    line.length, line.pins = _length(take), pins_json(take)
    takes.index = len(takes.items) - 1
    redraw(bpy.context, "UI")
    return line


def _require_listable(path: Path) -> None:
    """Raise MisnamedError if the name of `path` cannot be stored by Blender, whose texts are UTF-8."""
    try:
        (path.stem + relative(path)).encode()
    except UnicodeEncodeError as error:
        name = path.name.encode(errors="backslashreplace").decode()
        raise MisnamedError("The name of {name} is not valid UTF-8. Rename it and try again.", name=name) from error


def keep(scene: bpy.types.Scene, take: Take, name: str, video: str = "") -> FacemimeTake:
    """Write `take`, which was tracked from `video`, to a new file named after `name`, and add it to the list."""
    path = new_path(name)
    save_take(take, path)
    line = add(scene, path, take)
    line.video = video
    return line


def keep_beside(scene: bpy.types.Scene, take: Take, name: str) -> FacemimeTake:
    """Like `keep`, but add the take below the selected one."""
    takes = scene.facemime_takes
    place = min(takes.index + 1, len(takes.items))
    keep(scene, take, name, chosen(scene).video)
    takes.items.move(takes.index, place)
    takes.index = place
    return takes.items[place]


def change(line: FacemimeTake, take: Take) -> None:
    """Replace the take of `line` by `take` in a new file, so that undo finds the previous one."""
    path = new_path(line.name)
    save_take(take, path)
    line.path, line.packed, line.length = relative(path), None, _length(take)
    line.pins = pins_json(take)
    redraw(bpy.context, "UI")


def read(line: FacemimeTake, *, solved: bool = True) -> Take:
    """Read the take of `line`, as `load_take` does; raises SourceError if its file is missing or damaged."""
    if line.packed is not None:
        return _unpacked(line, solved)
    path = located(line.path)
    if not os.path.isfile(path):
        raise SourceError(
            "The file of the take {name} is missing: {path}. Restore it, or import it again.", name=line.name, path=path
        )
    return _loaded(path, path.stat().st_mtime_ns, solved)


def read_corrected(scene: bpy.types.Scene, line: FacemimeTake) -> Take:
    """Read a take as `read`, corrected by what other pins have told about the selected performer of a scene."""
    take = read(line)
    if pins_of(take) or take.info.get("measured"):
        return take
    return corrected(take, read_learnt(scene.facemime))


def write_pins(line: FacemimeTake, take: Take) -> None:
    """Give the file of `line` the pins of `take`, without changing what was tracked; raises OutputError."""
    if line.packed is not None:
        data = base64.b64decode(line.packed.as_string()) + pins_content(take)
        line.packed.from_string(base64.encodebytes(data).decode("ascii"))
    else:
        append_pins(take, located(line.path))
    line.pins = pins_json(take)


def has_pins(line: FacemimeTake) -> bool:
    """Return whether the take of `line` has pins, without reading it."""
    return f'"{PINS}"' in line.pins


def learns(line: FacemimeTake) -> bool:
    """Return whether they also correct alike frames."""
    return f'"{LEARN}"' in line.pins


def pins_json(take: Take) -> str:
    """Return the pins of a take, and whether it learns from them, as JSON."""
    return json.dumps({key: take.info[key] for key in (PINS, LEARN) if key in take.info})


def with_pins_of(take: Take, text: str) -> Take:
    """Return a take with the result of `pins_json` for another state of it."""
    info = {key: value for key, value in take.info.items() if key not in (PINS, LEARN)}
    return replace(take, info=info | as_object(parse_json(text.encode()), "it"))


def video_of(scene: bpy.types.Scene, line: FacemimeTake) -> Path | None:
    """Return the video that a take was tracked from, or None.

    It is where it was, in the folder of the take, the source of the scene, or the sample clip.
    """
    if line.video and (path := Path(bpy.path.abspath(line.video))).is_file():
        return path
    try:
        source = read(line).info.get("source")
    except SourceError:
        return None
    folders = (located(line.path).parent, default_folder(TAKES))
    chosen_one = Path(bpy.path.abspath(scene.facemime.source.video))
    places = (*(folder / str(source) for folder in folders), chosen_one, SAMPLE)
    return next((path for path in places if path.name == source and path.is_file()), None)


def sound_beside(video: Path) -> Path:
    """Return the sound file next to `video` with the same name, or `video` itself if there is none."""
    return next((path for suffix in SOUNDS if (path := video.with_suffix(suffix)).is_file()), video)


def pack(line: FacemimeTake) -> None:
    """Pack the take of `line` into the .blend file; its own file is kept."""
    read(line, solved=False)
    data = located(line.path).read_bytes()
    text = bpy.data.texts.new(f"{line.name}{SUFFIX}")
    text.from_string(base64.encodebytes(data).decode("ascii"))
    line.packed = text


def unpack(line: FacemimeTake) -> Path:
    """Write the packed take of `line` to a new file and return its path."""
    take, text = read(line, solved=False), line.packed
    path = new_path(line.name)
    save_take(take, path)
    line.path, line.packed = relative(path), None
    # A full copy of a scene shares the text.
    lines = (other for scene in bpy.data.scenes for other in scene.facemime_takes.items)
    if text is not None and all(other.packed != text for other in lines):
        bpy.data.texts.remove(text)
    return path


def is_listed(scene: bpy.types.Scene, path: Path) -> bool:
    """Return whether the take in a file is in the list."""
    return os.path.realpath(path) in _listed(scene)


def _listed(scene: bpy.types.Scene) -> set[str]:
    return {os.path.realpath(located(line.path)) for line in scene.facemime_takes.items if line.path}


def unlisted(scene: bpy.types.Scene) -> list[Path]:
    """Return the takes in the folder that are not in the list, such as removed ones; also those beside a .blend file
    whose folder has become read-only.
    """
    known, folders = _listed(scene), {folder()}
    if bpy.data.filepath:
        folders.add(Path(bpy.path.abspath(f"//{TAKES}")))
    takes = (path for place in folders for path in place.glob(f"[!.]*{SUFFIX}"))
    return sorted(path for path in takes if os.path.realpath(path) not in known)


def _length(take: Take) -> float:
    return float(take.times[-1] - take.times[0])


@lru_cache(maxsize=4)
def _loaded(path: Path, changed: int, solved: bool) -> Take:
    return load_take(path, solved=solved)


def _unpacked(line: FacemimeTake, solved: bool) -> Take:
    text = line.packed
    assert text is not None
    try:
        return take_of(base64.b64decode(text.as_string()), solved=solved)
    except NewerFormatError as error:
        raise SourceError(
            "The packed take {name} was written by a newer Facemime. Update Facemime.", name=line.name
        ) from error
    except (ValueError, binascii.Error) as error:
        raise SourceError(
            "The packed take {name} is damaged ({error}). Import it again.", name=line.name, error=error
        ) from error
