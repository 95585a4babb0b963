"""The meshes of a character, which of them may have its face, and the character that the user means.

A user may have selected any object of a character: importers leave the armature active and everything selected, and a
click in the viewport hits an eye or the hair. Every way of choosing a character leads here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.face.landmarks import N_LANDMARKS
from ...core.heads.key_map import KeyMap
from ...core.heads.key_presets import best_preset
from ...core.heads.part_names import find_bones, named_part, names_body, names_skin, names_whole_body
from ...core.numeric.arrays import FloatArray
from ..characters import ancestors, box_of, head_of, objects_of
from ..meshes import can_be_driven, is_head, key_names, key_offsets, key_points, keys_of, mesh_of, rest_bones
from ..names import MARKS_PROPERTY, PART_PROPERTY
from .levels import hide, is_copy, level_of, one_level

_LARGEST_PART = 2.0
"""Size of a loose part of a head, such as hair, relative to the largest extent of the head."""
_FEWEST = 12
"""Fewest vertices of a loose mesh that counts as a part by its position alone; the default cube has 8."""
_MOST_LIKELY = 3
"""Meshes of a character in which a face is sought, besides a body."""
_CHOSEN_BODY = 1.75
"""Score of a mesh that is named after the body if the user chose it: between those of a mesh that a name or keys tell
to be the face, and of one whose name says nothing."""
_STILL = 1e-6
"""Displacement, as a fraction of the size of a mesh, below which a vertex is at rest."""


def family_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the meshes of a character, with `obj` first if it is one: those of its armature, root or collection.

    In a collection, only meshes that are named after a part of a face or lie within the head count, as it may hold the
    entire scene. Meshes below the same root that another armature deforms belong to another character. Of levels
    of detail, only the finest counts, or that of `obj` if it is a head or has marks.
    """
    return one_level(_all_levels(obj), level_of(obj) if _is_settled(obj) else None)


def _is_settled(obj: bpy.types.Object) -> bool:
    """Return whether a mesh is that with the face, as it is bound or has marks."""
    return obj.type == "MESH" and (can_be_driven(obj) or MARKS_PROPERTY in mesh_of(obj))


def copies_of(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the meshes of a character that are copies of `head` in the same place, and have none of its shape keys."""
    keys = set(key_names(head))
    return [obj for obj in family_of(head) if keys.isdisjoint(key_names(obj)) and is_copy(obj, head)]


def hide_other_levels(head: bpy.types.Object) -> str:
    """Hide the other levels of detail of the character of `head`, and say so; "" if it has none that are visible."""
    levels, copies = _all_levels(head), copies_of(head)
    kept = {*one_level(levels, level_of(head)), *objects_of(head)}.difference(copies)
    others = [obj for obj in levels if obj not in kept]
    for obj in [obj for obj in others if _root_of(obj) != _root_of(head)]:  # each level may have its own armature
        others += one_level(_all_levels(obj), level_of(obj))
    return hide(dict.fromkeys(obj for obj in others if obj not in kept))


def _all_levels(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the meshes of the character of `obj`, those of coarser levels included, `obj` first if it is one."""
    armature, root, level = armature_of(obj), _root_of(obj), level_of(obj)
    found = []
    for other in bpy.context.scene.objects:
        if other == obj or other.type != "MESH" or not len(mesh_of(other).vertices):
            continue
        if other.get(PART_PROPERTY) is not None or is_head(other):
            continue
        theirs = armature_of(other)
        same = armature is not None and theirs == armature
        below = _root_of(other) == root and (armature is None or theirs is None)
        if same or below or _is_beside(other, obj) or (level is not None and _is_level(other, obj, level)):
            found.append(other)
    return [*([obj] if obj.type == "MESH" else []), *sorted(found, key=lambda other: other.name)]


def face_candidates(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the meshes of the character of `obj` that may have the skin of its face, the most likely first.

    `obj` is a mesh, an armature or an empty above. A mesh that is named after the body comes last, as its character
    may have a head of its own; one that is `obj` itself comes before what no name explains.
    """
    family = family_of(obj)
    scores = {other: _face_score(other) + 0.5 * (other == obj) for other in family}
    bodies = [other for other in family if scores[other] <= 0.0 and names_whole_body(other.name)]
    if obj in bodies:
        bodies.remove(obj)
        scores[obj] = _CHOSEN_BODY
    likely = sorted((other for other in family if scores[other] > 0.0), key=lambda other: -scores[other])
    return [*likely[:_MOST_LIKELY], *bodies[:1]] or ([obj] if obj.type == "MESH" else family[:1])


def known_keys(obj: bpy.types.Object) -> KeyMap | None:
    """Return the mapping to the known set of shape keys with most keys that a mesh of the character of `obj` has; None
    if none has such a set.
    """
    found = [table for member in family_of(obj) if (table := _preset_of(member)) is not None]
    return max(found, key=lambda table: len(table.keys), default=None)


def _preset_of(obj: bpy.types.Object) -> KeyMap | None:
    """Return the mapping to the known set of shape keys that move a mesh; fast enough for drawing a panel."""
    names = tuple(key_names(obj))
    if _preset(names) is None:
        return None
    known = (keys_of(obj).session_uid, len(mesh_of(obj).vertices), names)
    if known not in _moving:
        _moving[known] = tuple(name for name in names if moved_by_key(obj, name).any())
    return _preset(_moving[known])


_moving: dict[tuple[int, int, tuple[str, ...]], tuple[str, ...]] = {}
"""The keys that move something, by the identity of the shape keys, the number of vertices and the names of all keys."""


def moved_by_key(obj: bpy.types.Object, name: str) -> NDArray[np.float32]:
    """Return (V, 3) displacements of a key in the axes of the mesh in Blender, 0 where they are negligible."""
    block = keys_of(obj).key_blocks[name]
    offsets = key_offsets(block)
    size = float(np.ptp(key_points(block.relative_key), axis=0).max(initial=0.0))
    return np.where(np.abs(offsets) > _STILL * size, offsets, np.float32(0.0))


@lru_cache(maxsize=64)
def _preset(names: tuple[str, ...]) -> KeyMap | None:
    return best_preset(names)


def heads_of(
    objects: Iterable[bpy.types.Object], among: Iterable[bpy.types.Object] | None = None
) -> list[bpy.types.Object]:
    """Return the heads, by default of those in the scene, to which objects of characters lead, in their order."""
    heads = [obj for obj in (bpy.context.scene.objects if among is None else among) if can_be_driven(obj)]
    return list(dict.fromkeys(head for obj in objects for head in _heads_at(obj, heads)))


def _heads_at(obj: bpy.types.Object, heads: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the heads to which an object leads: itself, that of which it is a part, those of its armature, those
    below it, or the only one below the nearest object above it that has one.
    """
    own = head_of(obj)
    if can_be_driven(own):
        return [own]
    armature = armature_of(obj)
    if armature is not None and (carried := [head for head in heads if armature_of(head) == armature]):
        return carried
    place: bpy.types.Object | None = obj
    while place is not None:
        below = [head for head in heads if place in ancestors(head)]
        if below:
            return below if place == obj or len(below) == 1 else []
        place = place.parent
    return []


def character_in(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the object that leads to the character whose face is to be found, or None.

    It is the active object if that is a selected mesh, unless it is loose and named after something else than a face;
    otherwise the object among the selected and active ones that most likely belongs to a character; with nothing
    selected, one of the only character in sight, or in the scene if none is in sight.
    """
    active, selected = context.active_object, context.selected_objects
    chosen = list(dict.fromkeys([*([active] if active in selected else []), *selected, *([active] if active else [])]))
    if chosen and chosen[0] in selected and _may_have_face(chosen[0]) and not _is_loose_part(chosen[0]):
        return chosen[0]
    found = [obj for obj in chosen if leads_to_face(obj)]
    if not found or not selected:
        there = _characters(context.visible_objects) or _characters(context.scene.objects)
        found = [there[0][0], *found] if len(there) == 1 else found
    return max(found, key=lambda obj: (is_character(obj), not _is_loose_part(obj)), default=None)


def likely_character(objects: Iterable[bpy.types.Object]) -> bpy.types.Object | None:
    """Return the largest mesh of the characters in a file; None without any mesh that may have a face."""
    meshes = [mesh for group in _characters(objects) for mesh in group]
    carried = [mesh for mesh in meshes if armature_of(mesh) is not None or mesh.parent is not None]
    return max(carried or meshes, key=_size, default=None)


def require_character(obj: bpy.types.Object | None) -> bpy.types.Object:
    """Return `obj`, or a mesh of the finest level of detail if it is a copy of that one.

    Raises HeadError if `obj` is None or does not belong to a mesh.
    """
    if obj is None:
        raise HeadError("No character is selected. Select one, or add a head with Add > Mesh > Facemime Head.")
    if obj.type == "EMPTY" and obj.instance_collection is not None:
        raise HeadError(
            "{name} is an instance of a collection. Make its objects real first: Object > Apply > Make Instances Real.",
            name=obj.name,
        )
    if not family_of(obj):
        raise HeadError("{name} belongs to no mesh. Select a character, or add a head.", name=obj.name)
    if (level := level_of(obj)) is None or obj.type != "MESH":
        return obj
    meshes = family_of(obj)
    same = [other for other in meshes if (theirs := level_of(other)) is not None and theirs[0] == level[0]]
    return obj if obj in meshes else [*same, *meshes][0]


def leads_to_face(obj: bpy.types.Object) -> bool:
    """Return whether a mesh of the character of `obj` is large enough to have a face."""
    return any(map(_may_have_face, family_of(obj)))


def is_character(obj: bpy.types.Object) -> bool:
    """Return whether an object is certainly one of a character: by its shape keys, or by the bones and the names of
    its meshes.
    """
    if known_keys(obj) is not None:
        return True
    armature = armature_of(obj)
    return armature is not None and bool(find_bones(list(rest_bones(armature).keys()), {}).head) and leads_to_face(obj)


def _characters(objects: Iterable[bpy.types.Object]) -> list[list[bpy.types.Object]]:
    """Return the meshes of each character, or of each group of meshes if none is certainly a character."""
    groups: dict[bpy.types.Object, list[bpy.types.Object]] = {}
    for obj in filter(_may_have_face, objects):
        groups.setdefault(armature_of(obj) or _root_of(obj), []).append(obj)
    return [group for group in groups.values() if is_character(group[0])] or list(groups.values())


def _size(obj: bpy.types.Object) -> tuple[float, int]:
    return float(np.prod(obj.dimensions[:])), len(mesh_of(obj).vertices)


def _may_have_face(obj: bpy.types.Object) -> bool:
    return obj.type == "MESH" and len(mesh_of(obj).vertices) >= N_LANDMARKS and bool(len(mesh_of(obj).polygons))


def armature_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """Return the armature that deforms or carries `obj`, if there is one; an armature itself."""
    if obj.type == "ARMATURE":
        return obj
    if (armature := obj.find_armature()) is not None:
        return armature
    return next((above for above in ancestors(obj) if above.type == "ARMATURE"), None)


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
    score = 1.0 + 2.0 * any(map(names_skin, names)) + 1.0 * (_preset_of(obj) is not None)
    if all(named_part([name]) is not None for name in names) or named_part([obj.name]) is not None:
        score -= 4.0
    return score - 2.0 * names_body(obj.name)


def _is_beside(other: bpy.types.Object, obj: bpy.types.Object) -> bool:
    """Return whether a loose object in the same collection belongs to the character of `obj`.

    It does if it is named after a part of a face and lies near, or if `obj` is loose as well, and it lies within it
    without being much larger: eyes and hair of a head in a file whose objects are not joined in any way.
    """
    if obj.type != "MESH" or other.parent is not None or not set(other.users_collection) & set(obj.users_collection):
        return False
    if named_part([other.name]) is not None:
        return _overlap(box_of(obj), box_of(other))
    if not (_is_loose(obj) and _is_loose(other)) or len(mesh_of(other).vertices) < _FEWEST:
        return False
    (low, high), (other_low, other_high) = box_of(obj), box_of(other)
    middle = (other_low + other_high) / 2.0
    within = (low < middle).all() and (middle < high).all()
    return bool(within and (other_high - other_low < _LARGEST_PART * (high - low).max()).all())


def _is_level(other: bpy.types.Object, obj: bpy.types.Object, level: tuple[str, int]) -> bool:
    """Return whether a mesh is another level of detail of `obj`, whose name without its level, and level, are given."""
    theirs = level_of(other)
    named = theirs is not None and theirs[0] == level[0] and theirs[1] != level[1]
    return named and _overlap(box_of(obj), box_of(other))


def loose_companions(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the loose meshes that a loose `obj` touches, directly or through others: those of a character without
    bones. The one that most likely has the face comes first.
    """
    if not _is_loose(obj):
        return []
    loose = [
        other
        for other in bpy.context.scene.objects
        if other != obj and _is_loose(other) and _may_have_face(other) and other.get(PART_PROPERTY) is None
    ]
    loose = [other for other in loose if set(other.users_collection) & set(obj.users_collection)]
    boxes = {other: box_of(other) for other in loose}
    found, reached = list[bpy.types.Object](), [box_of(obj)]
    while reached:
        box = reached.pop()
        touching = [other for other in loose if other not in found and _overlap(box, boxes[other])]
        found += touching
        reached += [boxes[other] for other in touching]
    return sorted(found, key=lambda other: (-_face_score(other), -len(mesh_of(other).vertices)))


def _is_loose(obj: bpy.types.Object) -> bool:
    return obj.type == "MESH" and obj.parent is None and armature_of(obj) is None


def _is_loose_part(obj: bpy.types.Object) -> bool:
    """Return whether a loose mesh is named after something else than a face, such as teeth or shoes."""
    return _is_loose(obj) and _face_score(obj) <= 0.0


def _overlap(box: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> bool:
    return bool((other[0] < box[1]).all() and (other[1] > box[0]).all())


def _root_of(obj: bpy.types.Object) -> bpy.types.Object:
    return (obj, *ancestors(obj))[-1]
