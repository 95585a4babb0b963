"""Files with characters inside Blender: .blend files are opened, those of other programs imported."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import bpy
from mathutils import Matrix

from ..blender import head_properties
from ..blender.animation.clips import AnimationClip, clips_of, make_room, owners_of, play_single
from ..blender.contexts import scene_of, showing_scene
from ..blender.gltf_seconds import base_is_right, inverted_base
from ..blender.heads.binding import bind_character, check_object, placements, turn_note
from ..blender.heads.facegen import TRI, import_facegen, prepare_facegen
from ..blender.heads.family import character_of, family_of, heads_of, hide_other_levels, likely_character
from ..blender.heads.keyed import add_expressions, bind_keys, driven_by_its_keys, known_set
from ..blender.heads.look_keys import eyes_with_look_keys, look_keys_note
from ..blender.heads.neck import give_neck
from ..blender.heads.openings import open_eyes, open_lips
from ..blender.heads.painted_eyes import paint_skin_around_eyes
from ..blender.heads.parts import is_sorted
from ..blender.meshes import can_be_driven, mesh_of
from ..blender.rendering import quiet, set_rate
from ..blender.surfaces import lost_images
from ..core.errors import FacemimeError, HeadError, SourceError
from ..core.files.capture import check_readable, require_utf8_name
from ..core.files.locks import temporary_folder
from ..core.heads.bind import Binding
from ..core.heads.character_files import duration_of_gltf, gltf_of, rate_of_file
from ..core.puppet.job import CHARACTER_SUFFIXES, HeadFile
from .console import tell
from .guard import limited
from .stopping import STOPPING

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_GLTF = (".glb", ".gltf", ".vrm")


def _animation_rate(path: Path) -> float | None:
    """Return the frames per second of the animation in a file; None if it states none, or none that can be read."""
    if (rate := rate_of_file(path)) is not None or path.suffix.lower() not in _SUFFIXES:
        return rate
    # Blender's module does not search the folder of its own libraries; Blender 4.2 has no such library.
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    folder = Path(bpy.utils.resource_path("LOCAL"), "python", "lib", version, "site-packages")
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    with suppress(Exception):  # its errors, of a damaged file, have no common class; the importer reports the damage
        from pxr import Usd  # type: ignore[import-not-found]  # in Blender's own Python

        return float(Usd.Stage.Open(str(path)).GetTimeCodesPerSecond())
    return None


def _import_obj(path: Path) -> None:
    """Import an .obj file, also one whose lines end as on early Macs, which Blender takes for a single line."""
    if b"\r" not in (data := path.read_bytes()) or b"\n" in data:
        bpy.ops.wm.obj_import(filepath=str(path))
        return
    with temporary_folder() as folder:
        (folder / path.name).write_bytes(data.replace(b"\r", b"\n"))
        bpy.ops.wm.obj_import(filepath=str(folder / path.name))


_IMPORTERS: Mapping[str, Callable[..., object]] = {
    **dict.fromkeys(_GLTF, lambda path: bpy.ops.import_scene.gltf(filepath=path)),
    ".fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path),
    ".obj": lambda path: _import_obj(Path(path)),
    ".abc": lambda path: bpy.ops.wm.alembic_import(filepath=path, as_background_job=False),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), lambda path: bpy.ops.wm.usd_import(filepath=path)),
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path),
    TRI: lambda path: import_facegen(bpy.context, [Path(path)]),
}
_WHOLE = (".glb", ".vrm", ".fbx", ".abc", ".ply", ".stl", ".obj")
"""Suffixes of files that refer to no other files, and hold a vertex in no less than a byte."""
_WITH_RANGE = (".abc", ".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of files whose importers set the range of the scene."""
CUTS: Mapping[str, Callable[[bpy.types.Object], int]] = {"open_lips": open_lips, "open_eyes": open_eyes}
"""Functions that remedy the findings of the check of a head, by their steps."""


def open_blend(path: Path) -> None:
    """Open a .blend file without running its scripts; raises SourceError if that is not possible."""
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check its name.", path=path)
    place = os.path.realpath(path)
    require_utf8_name(Path(place))
    try:
        # A file from elsewhere may contain scripts: none is run, whatever the preferences say.
        with STOPPING.holding(), quiet(), limited(path):
            bpy.ops.wm.open_mainfile(filepath=place, use_scripts=False)
    except RuntimeError as error:
        raise SourceError(
            "{path} cannot be opened by this version of Blender. Check that it is a .blend file.", path=path
        ) from error
    _leave_modes()


def _leave_modes() -> None:
    """Leave the modes in which a file was saved and nothing can be baked: Edit Mode, and Tweak Mode of NLA strips."""
    layer = bpy.context.view_layer
    if (edited := next((obj for obj in layer.objects if obj.mode == "EDIT"), None)) is not None:
        with bpy.context.temp_override(active_object=edited, object=edited, edit_object=edited):
            bpy.ops.object.mode_set(mode="OBJECT")
    for owner in owners_of(bpy.data.objects):
        if owner.library is None and owner.animation_data is not None:
            owner.animation_data.use_tweak_mode = False


def object_named(path: Path, name: str) -> bpy.types.Object:
    """Return the object called `name` in the open file, which was read from `path`; raises HeadError if it has none."""
    # `get` raises on names that are not UTF-8.
    found = next((obj for obj in bpy.data.objects if obj.name == name), None)
    if found is None:
        names = ", ".join(obj.name for obj in bpy.data.objects if obj.type == "MESH") or "no mesh"
        raise HeadError("{path} has no object {name}. Choose one of: {names}.", path=path, name=name, names=names)
    return found


def choose_level(named: bpy.types.Object) -> None:
    """Hide the other levels of detail of a mesh that the user named, so that it is bound though others are finer."""
    if named.type == "MESH" and (note := hide_other_levels(named)):
        tell(f"{note}.")


def open_file(path: Path) -> None:
    """Open a .blend file, or import a file of another program into an empty one.

    Raises SourceError if it cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".blend":
        open_blend(path)
        return
    if not check_readable(path):
        raise SourceError("There is no file {path}. Check its name.", path=path)
    require_utf8_name(Path(os.path.realpath(path)))
    if suffix not in _IMPORTERS:
        raise SourceError(
            "{path} is not a file of a character. Use {suffixes}.", path=path, suffixes=", ".join(CHARACTER_SUFFIXES)
        )
    try:
        _import(path, inverted=suffix in _GLTF)
        if suffix in _GLTF and not base_is_right(bpy.context.scene, _last_frame(), duration_of_gltf(path)):
            _import(path)
        if suffix == ".vrm" and (count := add_expressions(gltf_of(path)[0], bpy.context.scene.objects)):
            tell(f"{path.name} is driven by {count} expressions of its own.")
    except (RuntimeError, AttributeError, OSError, ValueError, MemoryError) as error:
        if extension := re.search(r"Extension (\w+) is not available", str(error)):
            raise SourceError(
                "{path} is stored with {extension}, which this version of Blender cannot read. "
                "Export it again without compression, or use a .blend file.",
                path=path,
                extension=extension[1],
            ) from error
        raise SourceError(
            "{path} cannot be imported by this version of Blender ({error}). Export it again, or use a .blend file.",
            path=path,
            error=_reason(error),
        ) from error
    _require_plausible(path)
    clips = clips_of(owners_of(bpy.data.objects))
    make_room(clips)
    if suffix in _GLTF:
        play_single(clips)
    # The importers of other files than Alembic and USD leave the range of the scene as it is.
    if clips and suffix not in _WITH_RANGE:
        set_frames(clips)


def _import(path: Path, *, inverted: bool = False) -> None:
    """Import a file of another program into an empty one, with the base of the rate inverted on request."""
    with STOPPING.holding():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    # Before the import, as importers convert seconds to frames of the scene.
    if (rate := _animation_rate(path)) is not None:
        set_rate(bpy.context.scene, rate)
    with STOPPING.holding(), quiet(), limited(path), inverted_base(bpy.context.scene) if inverted else nullcontext():
        _IMPORTERS[path.suffix.lower()](str(path.resolve()))


def _last_frame() -> float:
    """Return the last frame of all actions of the open file."""
    return max((action.curve_frame_range[1] for action in bpy.data.actions), default=0.0)


def _require_plausible(path: Path) -> None:
    """Raise SourceError if more was imported than a file of this size can hold, as a damaged one may claim."""
    if path.suffix.lower() in _WHOLE and sum(len(mesh.vertices) for mesh in bpy.data.meshes) > path.stat().st_size:
        raise SourceError("{path} claims to have more vertices than bytes. It is damaged; export it again.", path=path)


def set_frames(clips: Mapping[str, AnimationClip]) -> None:
    """Set the range of the scene to the clips that play, or to all if none does."""
    playing = [clip for clip in clips.values() if clip.plays] or list(clips.values())
    scene, frames = bpy.context.scene, [clip.frames for clip in playing]
    scene.frame_start, scene.frame_end = min(first for first, _ in frames), max(last for _, last in frames)


def _reason(error: Exception) -> str:
    """The last line of an error of an operator, which may be that of an importer's traceback."""
    lines = [line.strip() for line in str(error).splitlines()]
    told = [line for line in lines if line and not line.startswith(("Location:", "File ", "Error: Python: Trace"))]
    return told[-1].removeprefix("Error: ") if told else "it is damaged"


def likely_mesh(path: Path) -> bpy.types.Object:
    """Return a mesh of the most likely character of the open file, in the active scene if there is one.

    Raises HeadError if the file has no mesh.
    """
    for scene in dict.fromkeys((bpy.context.scene, *bpy.data.scenes)):
        with showing_scene(scene):
            chosen = likely_character(scene.objects)
        meshes = (obj for obj in scene.objects if obj.type == "MESH" and len(obj.data.polygons))
        if (found := chosen or next(meshes, None)) is not None:
            return found
    raise HeadError(_why_without_mesh(path))


def _why_without_mesh(path: Path) -> str:
    """Return why the open file has no mesh in a scene, and what to do."""
    if missing := _missing_files(path):
        return missing
    return _only_instances(path) or f"{path} has no mesh. Choose another file."


def _only_instances(path: Path) -> str:
    """Return that the open file has instances of collections, and what to do; "" if it has none."""
    instances = [obj for obj in bpy.data.objects if obj.instance_collection is not None]
    if not instances:
        return ""
    linked = any(collection.library for obj in instances if (collection := obj.instance_collection))
    what = (
        "Make a library override in Blender: Object > Library Override > Make."
        if linked
        else "Make their objects real in Blender: Object > Apply > Make Instances Real."
    )
    names = ", ".join(obj.name for obj in instances)
    return f"{path} has instances of collections instead of meshes: {names}. {what}"


def _missing_files(path: Path) -> str:
    """Return that the open file links files which are missing, and what to do; "" if it does not."""
    libraries = (library.filepath for library in bpy.data.libraries)
    names = ", ".join(place for place in libraries if not os.path.exists(bpy.path.abspath(place)))
    return (
        f"{path} links files that are missing: {names}. Relocate them in Blender, and save it again." if names else ""
    )


@contextmanager
def read_from(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong with a stranger's file, in Blender or here, into a SourceError that names the file."""
    try:
        yield
    except FacemimeError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {_reason(error)}"
        raise SourceError(
            "{path} cannot be used ({reason}). It may be damaged; export it again.", path=path, reason=reason
        ) from error


def open_head(file: HeadFile, *, by_keys: Collection[str] | None = None) -> bpy.types.Object:
    """Open the head in a file. A character that is not bound yet is bound.

    One with a known set of shape keys for the coefficients `by_keys` of ARKit is bound by its keys alone. Raises
    FacemimeError if the file cannot be read, the object does not exist, several have landmarks, or no face is found.
    """
    path, name = file.path, file.name
    head_properties.ensure_registered()
    with read_from(path):
        open_file(path)
        bound = _bound_heads()
        if not name and len(bound) > 1:
            raise HeadError(
                "{path} has {bound} meshes with landmarks: {names}. Choose one: {path}:OBJECT.",
                path=path,
                bound=len(bound),
                names=", ".join(obj.name for obj in bound),
            )
        named = object_named(path, name) if name else None
        chosen = bound[0] if named is None and bound else named or likely_mesh(path)
        if (chosen.instance_collection or not chosen.users_scene) and (instances := _only_instances(path)):
            raise HeadError(instances)
        with showing_scene(scene_of(chosen)):
            if named is not None:
                choose_level(named)
            chosen = next(iter(heads_of([chosen])), chosen)
            if not mesh_of(chosen).vertices and (missing := _missing_files(path)):
                raise HeadError(missing)
            return chosen if can_be_driven(chosen) else _newly_bound(path, chosen, by_keys)


def _bound_heads() -> list[bpy.types.Object]:
    """Return the bound heads of the open file, of its scenes if they have any.

    Of linked duplicates, which share a mesh and its landmarks, it is the one that was bound.
    """
    every = [obj for obj in bpy.data.objects if obj.type == "MESH" and can_be_driven(obj)]
    shown = [obj for obj in every if obj.users_scene] or every
    of_meshes: dict[bpy.types.ID, bpy.types.Object] = {}
    for obj in shown:
        mesh = mesh_of(obj)
        if mesh not in of_meshes or (is_sorted(obj) and not is_sorted(of_meshes[mesh])):
            of_meshes[mesh] = obj
    return list(of_meshes.values())


def _newly_bound(path: Path, chosen: bpy.types.Object, by_keys: Collection[str] | None) -> bpy.types.Object:
    """Bind the character of an object, and say how."""
    sets = [found for member in family_of(chosen) if (found := known_set(member)) is not None]
    facegen = path.suffix.lower() == TRI  # whose morphs follow a face less closely than its skin does
    if by_keys is not None and not (by_keys and facegen) and any(found.sources.issuperset(by_keys) for found in sets):
        head = bound_by_keys(chosen)
        if facegen:
            paint_skin_around_eyes(head)
        tell(driven_by_its_keys(head))
        tell_of_lost_images(head)
        return head
    head, binding = bound_character(chosen)
    prepare_imported(path, head)
    tell_of_lost_images(head)
    if binding.doubt:
        tell(f"facemime: {binding.doubt}")
    tell(f"Bound {head.name}. To see its parts and landmarks: facemime bind {path} -o HEAD.blend --picture FACE.png")
    if joined := [finding.problem for finding in check_object(head) if finding.step in CUTS]:
        tell(" ".join([*joined, f"To mend this: facemime bind {path} -o HEAD.blend --cut-open"]))
    return head


def bound_character(obj: bpy.types.Object) -> tuple[bpy.types.Object, Binding]:
    """Bind the character of `obj`, and say what changed; result and errors are those of `bind_character`."""
    before = placements()
    head, binding = bind_character(obj)
    _tell_of_changes(head, before)
    if note := give_neck(head):
        tell(f"{note}.")
    return head, binding


def bound_by_keys(obj: bpy.types.Object) -> bpy.types.Object:
    """Bind the character of `obj` by its keys, and say what changed; result and errors are those of `bind_keys`."""
    before = placements()
    head = bind_keys(obj)
    _tell_of_changes(head, before)
    if note := look_keys_note(eyes_with_look_keys(head)):
        tell(f"{note}.")
    return head


def _tell_of_changes(head: bpy.types.Object, before: Mapping[bpy.types.Object, Matrix]) -> None:
    """Hide other levels of detail of a new head, and say so, and if it was rotated since it was placed as `before`."""
    for note in (turn_note(head, before), hide_other_levels(head)):
        if note:
            tell(f"{note}.")


def tell_of_lost_images(head: bpy.types.Object) -> None:
    """Say which images of a character are missing."""
    if lost := lost_images(character_of(head)):
        tell(
            f"Not found: {', '.join(lost)}. What these images colour is magenta. Export the character with its images "
            "embedded, or find them in Blender with File > External Data > Find Missing Files."
        )


def prepare_imported(path: Path, head: bpy.types.Object) -> None:
    """Give a head that was read from FaceGen's file, and is bound, eyes that turn; nothing for other files."""
    if path.suffix.lower() == TRI and prepare_facegen(head):
        tell("Its painted eyes were cut open, and became eyeballs that turn.")
