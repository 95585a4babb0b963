"""Files with the motion of heads: point caches, which the Mesh Cache modifier plays, Alembic, and glTF for browsers,
engines and other programs. What exporters leave out is made part of a file for as long as it is written.

Exporters take what is selected, and Blender selects nothing that is hidden, unselectable or in an excluded
collection, without a word. That of glTF leaves out muted shape keys, and the vertex groups and relative keys of
others.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from struct import Struct
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.point_cache import write_point_cache
from ...core.bake.whole_frames import in_between
from ...core.drive.driver import HeadMotion
from ...core.errors import HeadError, OutputError
from ...core.files.writing import replacing
from ...core.heads.character_files import duration_of_gltf
from ..characters import Member, ancestors, objects_of
from ..frames import to_blender
from ..gltf_seconds import base_is_right, inverted_base
from ..heads.binding import CACHES
from ..heads.family import armature_of, family_of
from ..meshes import key_points, keys_of, mesh_of
from ..muting import mute_for_now
from ..rendering import quiet
from ..view_layers import revealed, set_for_now
from .bake_keys import scaled_offsets, standing_vertices, value_path

SUFFIX = ".glb"
MODIFIER = "Facemime Cache"
_ALEMBIC_BYTES = 24
"""Maximum size of a vertex in a frame: its position and normal."""


@contextmanager
def saved_by_blender(path: Path, is_complete: Callable[[Path], bool]) -> Iterator[str]:
    """Yield the path for Blender to write to, without output; an existing file is replaced only by a complete one.

    `is_complete` says whether the file at a path has its end: Blender does not notice a disk that becomes full at the
    very end. Raises OutputError if the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.unlink()
        try:
            with quiet():
                yield str(temporary.resolve())
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1].removeprefix("Error: ")
            reason = reason[:1].lower() + reason[1:]
            raise OutputError(
                "Cannot write {path}: {reason}. Choose another location for the output.", path=path, reason=reason
            ) from error
        if not temporary.exists() or not is_complete(temporary):
            raise OutputError(
                "Cannot write {path}: no space is left. Choose another location for the output.", path=path
            )


@contextmanager
def selected_for_export(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Select some objects and nothing else, whatever hides them; the first is active. All returns to what it was.

    Raises OutputError if an object cannot be selected, so that an exporter would leave it out.
    """
    layer = bpy.context.view_layer
    selected, active = [obj for obj in layer.objects if obj.select_get()], layer.objects.active
    with ExitStack() as stack:
        stack.callback(_select, selected, active)
        stack.enter_context(revealed(objects))
        _select(objects, objects[0])
        if missing := [obj.name for obj in objects if not obj.select_get()]:
            names = ", ".join(missing)
            raise OutputError(
                "These objects cannot be exported: {names}. Show them and make them selectable.", names=names
            )
        yield


def _select(objects: Sequence[bpy.types.Object], active: bpy.types.Object | None) -> None:
    """Select objects and nothing else."""
    layer = bpy.context.view_layer
    layer.update()  # what was hidden or excluded has no effect before
    for obj in layer.objects:
        obj.select_set(obj in objects)
    layer.objects.active = active


@contextmanager
def keys_as_shown(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Give the shape keys of some meshes the points that show what they do, all relative to the Basis.

    A muted key stays among them, with the value 0.
    """
    meshes = {mesh_of(obj): obj for obj in objects if obj.type == "MESH" and mesh_of(obj).shape_keys is not None}
    with ExitStack() as stack:
        for obj in meshes.values():
            keys = keys_of(obj)
            if keys.use_relative and keys.library is None:
                _show_muted(stack, keys)
                _write_offsets(stack, obj)
        yield


def _show_muted(stack: ExitStack, keys: bpy.types.Key) -> None:
    """Unmute keys and hold them at 0, against what animates them."""
    muted = [key for key in keys.key_blocks if key.mute]
    mute_for_now(stack, keys, {value_path(key.name) for key in muted})
    for key in muted:
        set_for_now(stack, key, "value", 0.0)
        set_for_now(stack, key, "mute", False)


def _write_offsets(stack: ExitStack, obj: bpy.types.Object) -> None:
    """Put vertex groups and relative keys into the points of keys that have them."""
    keys = keys_of(obj)
    basis = keys.reference_key
    limited = [
        key
        for key in keys.key_blocks
        if key != basis and (key.vertex_group in obj.vertex_groups or key.relative_key != basis)
    ]
    before = [key_points(key) for key in limited]
    shown = [key_points(basis) + scaled_offsets(obj, key) for key in limited]
    for key, old, new in zip(limited, before, shown, strict=True):
        stack.callback(key.points.foreach_set, "co", np.ascontiguousarray(old).reshape(-1))
        key.points.foreach_set("co", np.ascontiguousarray(new, dtype=np.float32).reshape(-1))
        set_for_now(stack, key, "vertex_group", "")
        set_for_now(stack, key, "relative_key", basis)
    if limited:
        stack.callback(mesh_of(obj).update_tag)
        mesh_of(obj).update_tag()


_HEADER = Struct("<4sII")
"""Magic, version, and length of a binary glTF file."""


def export_gltf(heads: Sequence[bpy.types.Object], path: Path) -> None:
    """Write heads with all parts, bones and shape keys as binary glTF, with the scene's frame range as one clip.

    The other parts of their characters are included. An existing file is replaced only by a complete one. Raises
    HeadError if the motion of a head is in a cache, which glTF cannot store, or the exporter is disabled, and
    OutputError if the file cannot be written, or an object would be missing from it.
    """
    chosen = list(dict.fromkeys(obj for head in heads for obj in _character(head)))
    for obj in chosen:
        if any(modifier.type in CACHES for modifier in obj.modifiers):
            raise HeadError(
                "The motion of {name} is in a cache, which glTF cannot store. Bake to shape keys.", name=obj.name
            )
    if "gltf" not in dir(bpy.ops.export_scene):
        raise HeadError("Blender's glTF add-on is disabled. Enable it in Preferences > Add-ons.")
    scene = bpy.context.scene
    with selected_for_export(chosen), keys_as_shown(chosen), saved_by_blender(path, _is_complete) as temporary:
        with inverted_base(scene):
            _write_gltf(temporary)
        if not base_is_right(scene, scene.frame_end - scene.frame_start, duration_of_gltf(Path(temporary))):
            _write_gltf(temporary)


def _write_gltf(path: str) -> None:
    """Export what is selected, with the scene's frame range from 0 s on."""
    bpy.ops.export_scene.gltf(
        filepath=path,
        check_existing=False,
        export_format="GLB",
        use_selection=True,
        use_active_scene=True,  # an object may be in further scenes, each with a selection of its own
        # One clip: players show one at a time, and a face consists of the keys of several meshes.
        export_animation_mode="SCENE",
        export_anim_scene_split_object=False,
        export_anim_slide_to_zero=True,
        export_cameras=False,
        export_lights=False,
    )


def _character(head: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """The meshes of a character, their ancestors, and their descendants."""
    if (armature := armature_of(head)) is not None:
        yield armature
    for obj in (*family_of(head), *objects_of(head)):
        yield from (obj, *(child for child in obj.children_recursive if child.type == "MESH"))
        yield from ancestors(obj)


def _is_complete(path: Path) -> bool:
    """Whether a binary glTF file is as long as its header says."""
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
    return len(header) == _HEADER.size and _HEADER.unpack(header)[2] == path.stat().st_size


def bake_cache(members: Sequence[Member], motion: HeadMotion, frames: NDArray[np.floating[Any]], path: Path) -> None:
    """Write every whole frame of a motion to a point cache for each mesh, and add Mesh Cache modifiers that play them.

    A modifier is the first in the stack, so that the user's modifiers act on its result; it overrides shape keys. The
    frames (N,) may be fractional. `path` is the file for the head; those of other meshes also have their names. Raises
    OutputError if a file cannot be written.
    """
    for member in members:
        own = path if member is members[0] else with_name_of(path, member.obj)
        _bake_mesh(member, motion, frames, own)


def with_name_of(path: Path, obj: bpy.types.Object) -> Path:
    """Return the path of a cache with the name of `obj` added to the file's, for one of several objects."""
    return path.with_name(f"{path.stem} {bpy.path.clean_name(obj.name)}{path.suffix}")


def _bake_mesh(member: Member, motion: HeadMotion, frames: NDArray[np.floating[Any]], path: Path) -> None:
    obj = member.obj
    rest = to_blender(standing_vertices(obj))
    first, last = int(np.floor(frames[0] + 1e-3)), int(np.ceil(frames[-1] - 1e-3))

    def samples() -> Iterator[NDArray[np.floating[Any]]]:
        for frame in range(first, last + 1):
            yield rest + member.local_offsets(in_between(frames, motion.vertices, frame))

    write_point_cache(path, samples(), len(rest), first)
    modifier = obj.modifiers.get(MODIFIER) or obj.modifiers.new(MODIFIER, "MESH_CACHE")
    obj.modifiers.move(obj.modifiers.find(MODIFIER), 0)
    assert isinstance(modifier, bpy.types.MeshCacheModifier)
    modifier.cache_format = "PC2"
    modifier.filepath = bpy.path.relpath(str(path.resolve())) if bpy.data.filepath else str(path.resolve())
    modifier.frame_start = first
    modifier.interpolation = "LINEAR"


def remove_cache(obj: bpy.types.Object) -> None:
    """Remove the cache modifier of `obj`; the file is kept."""
    if (modifier := obj.modifiers.get(MODIFIER)) is not None:
        obj.modifiers.remove(modifier)


@contextmanager
def caches_beside(path: Path) -> Iterator[None]:
    """Make the paths of caches in the folder of `path` relative while a copy of the file is saved there."""
    with ExitStack() as stack:
        for modifier in (obj.modifiers.get(MODIFIER) for obj in bpy.data.objects):
            if isinstance(modifier, bpy.types.MeshCacheModifier):
                file = Path(bpy.path.abspath(modifier.filepath))
                if file.parent == path.resolve().parent:
                    set_for_now(stack, modifier, "filepath", f"//{file.name}")
        yield


def export_alembic(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], path: Path) -> None:
    """Export a head with its parts as Alembic.

    Raises OutputError if this Blender does not support Alembic, or the file cannot be written.
    """
    if not getattr(bpy.app.build_options, "alembic", False):
        raise OutputError("This Blender was built without Alembic. Bake to a mesh cache instead.")
    vertices = sum(len(mesh_of(part).vertices) for part in objects if part.type == "MESH")
    needed = _ALEMBIC_BYTES * vertices * (scene.frame_end - scene.frame_start + 1)
    if shutil.disk_usage(path.parent).free < needed:  # Blender crashes when the disk is full
        raise OutputError(
            "Cannot write {path}: up to {needed:.0f} MB are needed. Free some disk space.",
            path=path,
            needed=needed / 1e6,
        )
    with replacing(path) as temporary, selected_for_export(objects):
        try:
            with quiet():
                bpy.ops.wm.alembic_export(
                    filepath=str(temporary.resolve()),
                    check_existing=False,
                    start=scene.frame_start,
                    end=scene.frame_end,
                    selected=True,
                    evaluation_mode="VIEWPORT",
                    as_background_job=False,
                )
        except RuntimeError as error:
            raise OutputError(
                "Blender could not write {path} ({error}). Choose another location.", path=path, error=error
            ) from error
        if temporary.stat().st_size == 0:
            raise OutputError(
                "Blender could not write {path}. Free some disk space, or choose another location.", path=path
            )
