"""Export of heads and their animation, as glTF for browsers, engines and other programs. What exporters leave out is
made part of a file for as long as it is written, and files are written either completely or not at all.

Exporters take what is selected, and Blender selects nothing that is hidden, unselectable or in an excluded
collection, without a word. That of glTF leaves out muted shape keys, and the vertex groups and relative keys of
others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from struct import Struct

import bpy
import numpy as np

from ...core.errors import HeadError, OutputError
from ...core.files.writing import replacing
from ..characters import objects_of
from ..heads.binding import CACHES
from ..heads.family import armature_of, family_of
from ..meshes import key_points, keys_of, mesh_of
from ..muting import mute_for_now
from ..rendering import quiet
from ..view_layers import revealed, set_for_now
from .bake_keys import scaled_offsets, value_path

SUFFIX = ".glb"


@contextmanager
def saved_by_blender(path: Path, is_complete: Callable[[Path], bool]) -> Iterator[str]:
    """Yield the path for Blender to write to, without output; an existing file is replaced only by a complete one.

    Parameters
    ----------
    is_complete : callable
        Whether the file at a path has its end: Blender does not notice a disk that becomes full at the very end.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.unlink()
        try:
            with quiet():
                yield str(temporary.resolve())
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1].removeprefix("Error: ")
            reason = reason[:1].lower() + reason[1:]
            raise OutputError(f"Cannot write {path}: {reason}. Choose another location for the output.") from error
        if not temporary.exists() or not is_complete(temporary):
            raise OutputError(f"Cannot write {path}: no space is left. Choose another location for the output.")


@contextmanager
def selected_for_export(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Select some objects and nothing else, whatever hides them; the first is active. All returns to what it was.

    Raises
    ------
    OutputError
        If an object cannot be selected, so that an exporter would leave it out.
    """
    layer = bpy.context.view_layer
    selected, active = [obj for obj in layer.objects if obj.select_get()], layer.objects.active
    with ExitStack() as stack:
        stack.callback(_select, selected, active)
        stack.enter_context(revealed(objects))
        _select(objects, objects[0])
        if missing := [obj.name for obj in objects if not obj.select_get()]:
            names = ", ".join(missing)
            raise OutputError(f"These objects cannot be exported: {names}. Show them and make them selectable.")
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

    Parameters
    ----------
    heads : sequence of bpy.types.Object
        Any meshes with landmarks; the other parts of their characters are included.
    path : Path
        The file to write; an existing one is replaced only by a complete one.

    Raises
    ------
    HeadError
        If the motion of a head is in a cache, which glTF cannot store, or the exporter is disabled.
    OutputError
        If the file cannot be written, or an object would be missing from it.
    """
    chosen = list(dict.fromkeys(obj for head in heads for obj in _character(head)))
    for obj in chosen:
        if any(modifier.type in CACHES for modifier in obj.modifiers):
            raise HeadError(f"The motion of {obj.name} is in a cache, which glTF cannot store. Bake to shape keys.")
    if "gltf" not in dir(bpy.ops.export_scene):
        raise HeadError("Blender's glTF add-on is disabled. Enable it in Preferences > Add-ons.")
    with selected_for_export(chosen), keys_as_shown(chosen), saved_by_blender(path, _is_complete) as temporary:
        bpy.ops.export_scene.gltf(
            filepath=temporary,
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
        carrier = obj.parent
        while carrier is not None:
            yield carrier
            carrier = carrier.parent


def _is_complete(path: Path) -> bool:
    """Whether a binary glTF file is as long as its header says."""
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
    return len(header) == _HEADER.size and _HEADER.unpack(header)[2] == path.stat().st_size
