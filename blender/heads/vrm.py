"""Expressions of an imported VRM avatar as shape keys of their own, by which it is driven."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.key_map import ESSENTIAL
from ...core.bake.key_names import normalised
from ...core.heads.vrm import MorphBind, expressions_of
from ..meshes import keys_of, mesh_of
from .keyed import known_set


def add_expressions(gltf: Mapping[str, Any], objects: Iterable[bpy.types.Object]) -> int:
    """Add a shape key for each expression of a VRM avatar, unless its meshes have a complete known set already.

    Parameters
    ----------
    gltf : mapping
        JSON of the file.
    objects : iterable of bpy.types.Object
        What Blender has imported from it.

    Returns
    -------
    int
        Number of expressions that were added.

    Raises
    ------
    ValueError
        If the file is damaged.
    """
    meshes = {mesh_of(obj): obj for obj in objects if obj.type == "MESH" and mesh_of(obj).shape_keys is not None}
    sets = [found for obj in meshes.values() if (found := known_set(obj)) is not None]
    if any(found.sources >= ESSENTIAL for found in sets):
        return 0
    names = [str(mesh.get("name", "")) for mesh in gltf.get("meshes", ())]
    added = 0
    for name, binds in expressions_of(gltf).items():
        by_mesh: dict[bpy.types.Mesh, list[MorphBind]] = {}
        for bind in binds:
            if (mesh := _imported(names, bind.mesh, list(meshes))) is not None:
                by_mesh.setdefault(mesh, []).append(bind)
        added += sum(_add(meshes[mesh], name, chosen) for mesh, chosen in by_mesh.items()) > 0
    return added


def _imported(names: Sequence[str], index: int, meshes: Sequence[bpy.types.Mesh]) -> bpy.types.Mesh | None:
    """Return the mesh that Blender made of a mesh of the file: it shortens and numbers names that occur twice."""
    if index >= len(names):
        return None
    earlier = names[:index].count(names[index])
    same = [mesh for mesh in meshes if mesh.name.rpartition(".")[0] == names[index] or mesh.name == names[index][:63]]
    same.sort(key=lambda mesh: mesh.name)
    return same[min(earlier, len(same) - 1)] if same else None


def _add(obj: bpy.types.Object, name: str, binds: Sequence[MorphBind]) -> bool:
    """Add the mixture of morph targets as a shape key, unless there is one of that name."""
    blocks = keys_of(obj).key_blocks
    targets = [block for block in blocks if block != keys_of(obj).reference_key]
    if any(normalised(block.name) == normalised(name) for block in blocks):
        return False
    basis = _points(keys_of(obj).reference_key)
    moved = basis.copy()
    for bind in binds:
        if bind.target < len(targets):
            moved += bind.weight * (_points(targets[bind.target]) - basis)
    if not np.isfinite(moved).all() or np.array_equal(moved, basis):
        return False
    key = obj.shape_key_add(name=name, from_mix=False)
    key.value = 0.0
    key.points.foreach_set("co", moved)
    return True


def _points(key: bpy.types.ShapeKey) -> NDArray[Any]:
    flat = np.empty(3 * len(key.points), dtype=np.float32)
    key.points.foreach_get("co", flat)
    return flat
