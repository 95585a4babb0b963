"""The meshes of a character, and which of them may have its face."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from ...core.arrays import FloatArray
from ...core.bake.key_map import best_preset
from ...core.heads.sorting import named_part, names_body, names_skin
from ..characters import objects_of, rest_matrix
from ..meshes import is_head
from ..names import PART_PROPERTY


def family_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the meshes of a character, with `obj` first: those of its armature, its root or its collection.

    In a collection, only meshes named after a part of a face count, as it may hold the entire scene.
    """
    armature = armature_of(obj)
    root = _root_of(obj)
    found = []
    for other in bpy.context.scene.objects:
        if other == obj or other.type != "MESH" or other.get(PART_PROPERTY) is not None or is_head(other):
            continue
        same = armature is not None and armature_of(other) == armature
        if same or (root != obj and _root_of(other) == root) or _root_of(other) == obj or _is_beside(other, obj):
            found.append(other)
    return [obj, *sorted(found, key=lambda other: other.name)]


def face_candidates(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the meshes of the character of `obj` that may have the skin of its face, the most likely first."""
    family = family_of(obj)
    scores = {other: _face_score(other) + 0.5 * (other == obj) for other in family}
    return sorted((other for other in family if scores[other] > 0.0), key=lambda other: -scores[other]) or [obj]


def armature_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """Return the armature that deforms or carries `obj`, if there is one."""
    if (armature := obj.find_armature()) is not None:
        return armature
    parent = obj.parent
    while parent is not None and parent.type != "ARMATURE":
        parent = parent.parent
    return parent


def character_of(head: bpy.types.Object) -> set[bpy.types.Object]:
    """Return all objects of the character of a head: what has the same root, and the meshes of its face."""
    root = _root_of(head)
    return {root, *root.children_recursive, head, *objects_of(head)}


def material_names(obj: bpy.types.Object) -> list[str]:
    """Return the names of the materials of `obj`, "" for empty slots."""
    return ["" if slot.material is None else slot.material.name for slot in obj.material_slots]


def _face_score(obj: bpy.types.Object) -> float:
    """Return how likely a mesh has the skin of the face, by names and shape keys; 0 or less is unlikely."""
    names = [obj.name, *material_names(obj)]
    keys = obj.data.shape_keys
    known = keys is not None and best_preset([key.name for key in keys.key_blocks]) is not None
    score = 1.0 + 2.0 * any(map(names_skin, names)) + 1.0 * known
    if all(named_part([name]) is not None for name in names) or named_part([obj.name]) is not None:
        score -= 4.0
    return score - 2.0 * names_body(obj.name)


def _is_beside(other: bpy.types.Object, obj: bpy.types.Object) -> bool:
    """Return whether a loose object is named after a part of a face, and lies in the same collection near `obj`."""
    if other.parent is not None or named_part([other.name]) is None:
        return False
    if not set(other.users_collection) & set(obj.users_collection):
        return False
    (low, high), (other_low, other_high) = _box(obj), _box(other)
    return bool((other_low < high).all() and (other_high > low).all())


def _box(obj: bpy.types.Object) -> tuple[FloatArray, FloatArray]:
    corners = np.array([rest_matrix(obj) @ Vector(corner) for corner in obj.bound_box])
    return corners.min(axis=0), corners.max(axis=0)


def _root_of(obj: bpy.types.Object) -> bpy.types.Object:
    while obj.parent is not None:
        obj = obj.parent
    return obj
