"""Levels of detail: coarser copies of a character's meshes in the same place, which games show from farther away.

Blender shows all levels at once. Copies that do not move hide the face that does. Most are known by their names; copies
of a face also by their shape, as names are lost on the way through many formats.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import numpy as np

from ...core.errors import Message
from ...core.heads.part_names import level_of_detail, without_number
from ...core.mesh.surface import NearestPoints, surface_normals
from ...core.numeric import linalg
from ...core.numeric.arrays import FloatArray
from ..characters import ancestors, box_of, rest_matrix
from ..frames import to_blender
from ..meshes import key_names, mesh_of, read_faces, read_vertices

_SAME = 0.1
"""Largest distance between the corners of two levels of the same meshes, relative to the size of the one that stays."""
_EQUAL = 0.01
"""The same distance for a copy that is known by its shape. Of an avatar's head, copies with half and a fifth of the
faces have at most 0.003."""
_ON = 0.02
"""Distance from the vertices of a mesh, relative to its size, within which a copy lies on it. 8 in 10 vertices of these
copies are within 0.005 and 0.013."""
_ALIKE = 0.8
"""Share of the vertices of a copy that lie on the mesh and face the same way. An outline, as toons have it, lies on the
skin as well, but faces inwards."""
_LISTED = 3
"""Most names that a note lists."""


def level_of(obj: bpy.types.Object) -> tuple[str, int] | None:
    """Return the name of a mesh without its level of detail, and the level; None if neither its name nor that of an
    object above it or of a collection has one.
    """
    if (own := level_of_detail(obj.name)) is not None:
        return own
    above = (level_of_detail(other.name) for other in (*ancestors(obj), *obj.users_collection))
    return next(((without_number(obj.name), level[1]) for level in above if level is not None), None)


def one_level(objects: Sequence[bpy.types.Object], wanted: tuple[str, int] | None = None) -> list[bpy.types.Object]:
    """Return meshes of a character without copies of those of one level of detail: the `wanted` one, or else the finest
    of which something is visible.

    Another level is a copy if it has a mesh with the same name, or is the same size in the same place.
    """
    levels = {obj: level for obj in objects if (level := level_of(obj)) is not None}
    groups: dict[int, list[bpy.types.Object]] = {}
    for obj, (_, number) in levels.items():
        groups.setdefault(number, []).append(obj)
    if len(groups) < 2:
        return list(objects)
    visible = [number for obj, (_, number) in levels.items() if obj.visible_get()]
    best = min(visible or groups) if wanted is None or wanted[1] not in groups else wanted[1]
    names = {levels[obj][0] for obj in groups[best]}
    copies = {
        obj
        for number, group in groups.items()
        if number != best and (any(levels[obj][0] in names for obj in group) or _coincide(groups[best], group))
        for obj in group
    }
    return [obj for obj in objects if obj not in copies]


def is_copy(obj: bpy.types.Object, of: bpy.types.Object) -> bool:
    """Return whether a mesh is at most as fine as another one, as large, lies on it and faces the same way."""
    if obj == of or _fineness(obj) > _fineness(of) or not _coincide([of], [obj], _EQUAL):
        return False
    low, high = box_of(of)
    (places, facing), (others, theirs) = _surface(obj), _surface(of)
    found, squared = NearestPoints(others).query(places)
    near = squared[:, 0] < (_ON * (high - low).max()) ** 2
    alike = (facing * theirs[found[:, 0]]).sum(axis=1) > 0.0
    return bool((near & alike).mean() > _ALIKE)


def _fineness(obj: bpy.types.Object) -> tuple[int, int]:
    """Shape keys and vertices of a mesh; copies usually have no keys, whatever the number of their vertices."""
    return len(key_names(obj)), len(mesh_of(obj).vertices)


def without_copies(objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return meshes in their order, each copy replaced by the finest mesh that it is one of."""

    def finest(obj: bpy.types.Object) -> bpy.types.Object:
        return max([obj, *(of for of in objects if is_copy(obj, of))], key=_fineness)

    return list(dict.fromkeys(map(finest, objects)))


def hide(objects: Iterable[bpy.types.Object]) -> str:
    """Hide other levels of detail in the viewport and in renders, and say so; "" if none of them was visible."""
    hidden = [obj for obj in objects if obj.visible_get()]
    for obj in hidden:
        obj.hide_set(True)
        obj.hide_render = True
    if not hidden:
        return ""
    names, more = ", ".join(obj.name for obj in hidden[:_LISTED]), len(hidden) - _LISTED
    if more <= 0:
        return Message("Hidden, as they are other levels of detail in the same place: {names}", names=names)
    return Message(
        "Hidden, as they are other levels of detail in the same place: {names} and {more} more", names=names, more=more
    )


def _surface(obj: bpy.types.Object) -> tuple[FloatArray, FloatArray]:
    """Vertices of a mesh and their normals, (V, 3) each, at rest in the world."""
    vertices, matrix = to_blender(read_vertices(mesh_of(obj))), np.array(rest_matrix(obj))
    normals = surface_normals(vertices, read_faces(mesh_of(obj))) @ linalg.inv(matrix[:3, :3])
    return vertices @ matrix[:3, :3].T + matrix[:3, 3], normals


def _coincide(kept: Iterable[bpy.types.Object], others: Iterable[bpy.types.Object], apart: float = _SAME) -> bool:
    (low, high), (other_low, other_high) = _box(kept), _box(others)
    away = max(np.abs(low - other_low).max(), np.abs(high - other_high).max())
    return bool(away < apart * (high - low).max())


def _box(objects: Iterable[bpy.types.Object]) -> tuple[FloatArray, FloatArray]:
    boxes = [box_of(obj) for obj in objects]
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)
