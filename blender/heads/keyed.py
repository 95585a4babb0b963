"""Characters that are driven only by their own shape keys, without landmarks, such as an imported VRM avatar."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.key_quality import face_from_keys
from ...core.errors import HeadError
from ...core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, normalised
from ...core.heads.character_files import MorphBind, expressions_of
from ...core.heads.key_map import KeyMap
from ...core.heads.key_presets import ESSENTIAL, best_preset
from ...core.heads.part_names import FaceBones, names_body
from ...core.heads.rig import Part, neck_of
from ..characters import write_bones, write_kinds
from ..frames import HEAD_TO_BLENDER, from_blender, to_blender
from ..meshes import group_weights, key_names, key_points, keys_of, mesh_of, read_vertices
from ..names import COUNT_PROPERTY, HEAD_PROPERTY, KEYS_PROPERTY, PIVOT_PROPERTY
from .binding import turn_mesh
from .family import armature_of, copies_of, family_of, heads_of, moved_by_key, require_character
from .look_keys import give_eyes_keys
from .parts import bones_of

_OWN_WEIGHT = 0.5
"""Weight of the bone of an eye above which a vertex belongs to that eye."""


def known_set(obj: bpy.types.Object) -> KeyMap | None:
    """Return the mapping of the known set of shape keys that moves a mesh; None if it has no such set."""
    return best_preset([name for name in key_names(obj) if moved_by_key(obj, name).any()])


def bind_keys(obj: bpy.types.Object | None) -> bpy.types.Object:
    """Bind the character of `obj` by its shape keys, so that it can be driven without landmarks.

    Returns the mesh with most keys, to which the others belong. Raises HeadError if no mesh of the character has a
    known set of keys, or too few of them move anything.
    """
    obj = require_character(obj)
    if len(bound := heads_of([obj])) == 1:
        return bound[0]
    family = family_of(obj)
    sets = {member: found for member in family if (found := known_set(member)) is not None}
    if not sets:
        raise HeadError(
            "No mesh of {name} has shape keys of a known set. Find its face instead, or add such keys.", name=obj.name
        )
    head = max(sets, key=lambda member: len(sets[member].keys))
    table = sets[head]
    keys = [name for name in table.keys if name in key_names(head)]
    mixtures = np.array([_mixture(table, name) for name in keys])
    face = face_from_keys(
        read_vertices(mesh_of(head)), mixtures, [from_blender(moved_by_key(head, name)) for name in keys]
    )
    if not np.allclose(face.upright, np.eye(3)):
        turn_mesh(head, HEAD_TO_BLENDER @ face.upright @ HEAD_TO_BLENDER.T)
    mesh_of(head)[KEYS_PROPERTY] = face.landmarks.tolist()
    mesh_of(head)[COUNT_PROPERTY] = len(mesh_of(head).vertices)
    copies = copies_of(head)
    for member in family:
        if member != head and not names_body(member.name) and member not in copies:
            part = Part.ON_SKIN if set(key_names(member)) & set(table.keys) else Part.ON_HEAD
            write_kinds(mesh_of(member), np.full(len(mesh_of(member).vertices), part))
            member[HEAD_PROPERTY] = head
    armature = armature_of(head)
    bones = _without_moved_eyes(bones_of(head, armature, face.landmarks), [m for m in family if m in sets])
    write_bones(head, armature if bones.head else None, bones)
    head[PIVOT_PROPERTY] = to_blender(neck_of(read_vertices(mesh_of(head))[face.landmarks])).tolist()
    give_eyes_keys(head, table)
    return head


def driven_by_its_keys(head: bpy.types.Object) -> str:
    """Return a text that says what the shape keys show of a performance that drive a head without landmarks."""
    table = known_set(head)
    covered = "" if table is None else f" {table.summary()}"
    return f"{head.name} is driven by its shape keys alone.{covered}"


def _mixture(table: KeyMap, key: str) -> NDArray[Any]:
    """Return (52,) gains of the units that a mapping assigns to a key."""
    mixture = np.zeros(len(COEFFICIENTS))
    for row in table.rows:
        if row.key == key:
            mixture[COEFFICIENT_INDEX[row.source]] = row.gain
    return mixture


def _without_moved_eyes(bones: FaceBones, meshes: list[bpy.types.Object]) -> FaceBones:
    """Return `bones` without those of eyes that keys already rotate."""
    moved = [name for name in (bones.eye_right, bones.eye_left) if name and any(_look(m, name) for m in meshes)]
    return replace(
        bones,
        eye_right="" if bones.eye_right in moved else bones.eye_right,
        eye_left="" if bones.eye_left in moved else bones.eye_left,
    )


def _look(obj: bpy.types.Object, bone: str) -> bool:
    """Return whether a key for the direction of the eyes moves the vertices of an eye's bone."""
    own = group_weights(obj, bone) > _OWN_WEIGHT
    return bool(own.any()) and any(moved_by_key(obj, key)[own].any() for key in key_names(obj) if "look" in key.lower())


def add_expressions(gltf: Mapping[str, Any], objects: Iterable[bpy.types.Object]) -> int:
    """Add a shape key for each expression of a VRM avatar, unless its meshes have a complete known set already.

    `gltf` is the JSON of the file, and `objects` are what Blender has imported from it. Returns the number of
    expressions that were added. Raises ValueError if the file is damaged.
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
    basis = key_points(keys_of(obj).reference_key).reshape(-1)
    moved = basis.copy()
    for bind in binds:
        if bind.target < len(targets):
            moved += bind.weight * (key_points(targets[bind.target]).reshape(-1) - basis)
    if not np.isfinite(moved).all() or np.array_equal(moved, basis):
        return False
    key = obj.shape_key_add(name=name, from_mix=False)
    key.value = 0.0
    key.points.foreach_set("co", moved)
    return True
