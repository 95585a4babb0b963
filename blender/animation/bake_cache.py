"""Bakes of all vertices to a point cache, which the Mesh Cache modifier plays, and to Alembic for other programs."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.point_cache import in_between, write_point_cache
from ...core.drive.motion import HeadMotion
from ...core.errors import OutputError
from ...core.files.writing import replacing
from ..characters import Member
from ..frames import to_blender
from ..meshes import mesh_of
from ..rendering import quiet
from .bake_keys import standing_vertices
from .exporting import selected_for_export

MODIFIER = "Facemime Cache"
_ALEMBIC_BYTES = 24
"""Maximum size of a vertex in a frame: its position and normal."""


def bake_cache(members: Sequence[Member], motion: HeadMotion, frames: NDArray[np.floating[Any]], path: Path) -> None:
    """Write every whole frame of a motion to a point cache for each mesh, and add Mesh Cache modifiers that play them.

    A modifier is the first in the stack, so that the user's modifiers act on its result; it overrides shape keys.

    Parameters
    ----------
    members : sequence of Member
        Meshes of the head.
    frames : (N,) array
        Frames of the motion in the scene, which may be fractional.
    path : Path
        File to write for the head; those of other meshes also have their names.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    for member in members:
        own = path if member is members[0] else with_name_of(path, member.obj)
        _bake_mesh(member, motion, frames, own)


def with_name_of(path: Path, obj: bpy.types.Object) -> Path:
    """Return `path` with the name of `obj` added to the file's, for one of several objects.

    Parameters
    ----------
    path : Path
        Path of a cache.
    """
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


@contextlib.contextmanager
def caches_beside(path: Path) -> Iterator[None]:
    """Make the paths of caches in the folder of `path` relative while a copy of the file is saved there."""
    modifiers = [
        modifier
        for obj in bpy.data.objects
        if isinstance(modifier := obj.modifiers.get(MODIFIER), bpy.types.MeshCacheModifier)
        and Path(bpy.path.abspath(modifier.filepath)).parent == path.resolve().parent
    ]
    before = [modifier.filepath for modifier in modifiers]
    for modifier in modifiers:
        modifier.filepath = f"//{Path(modifier.filepath).name}"
    try:
        yield
    finally:
        for modifier, filepath in zip(modifiers, before, strict=True):
            modifier.filepath = filepath


def export_alembic(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], path: Path) -> None:
    """Export a head with its parts as Alembic.

    Parameters
    ----------
    path : Path
        File to write.

    Raises
    ------
    OutputError
        If this Blender does not support Alembic, or the file cannot be written.
    """
    if not getattr(bpy.app.build_options, "alembic", False):
        raise OutputError("This Blender was built without Alembic. Bake to a mesh cache instead.")
    vertices = sum(len(mesh_of(part).vertices) for part in objects if part.type == "MESH")
    needed = _ALEMBIC_BYTES * vertices * (scene.frame_end - scene.frame_start + 1)
    if shutil.disk_usage(path.parent).free < needed:  # Blender crashes when the disk is full
        raise OutputError(f"Cannot write {path}: up to {needed / 1e6:.0f} MB are needed. Free some disk space.")
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
            raise OutputError(f"Blender could not write {path} ({error}). Choose another location.") from error
        if temporary.stat().st_size == 0:
            raise OutputError(f"Blender could not write {path}. Free some disk space, or choose another location.")
