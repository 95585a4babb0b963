"""Heads and their animation as a glTF file, which browsers, engines and other programs open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from struct import Struct

import bpy

from ...core.errors import HeadError
from ..characters import objects_of
from ..heads.binding import CACHES
from ..heads.family import armature_of, family_of
from ..media.saving import saved_by_blender
from .exporting import keys_as_shown, selected_for_export

SUFFIX = ".glb"
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
            raise HeadError(
                "The motion of {name} is in a cache, which glTF cannot store. Bake to shape keys.", name=obj.name
            )
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
