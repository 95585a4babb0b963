"""Levels of detail: coarser copies of a character's meshes in the same place, which games show from farther away.

Blender shows all levels at once. Copies that do not move hide the face that does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import numpy as np

from ...core.errors import Message
from ...core.heads.part_names import level_of_detail, without_number
from ...core.numeric.arrays import FloatArray
from ..characters import ancestors, box_of

_SAME = 0.1
"""Largest distance between the corners of two levels of the same meshes, relative to the size of the one that stays."""
_LISTED = 3
"""Most names that a note lists."""


def level_of(obj: bpy.types.Object) -> tuple[str, int] | None:
    """Return the name of a mesh without its level of detail, and the level; None if neither its name nor that of an
    object above it has one.
    """
    if (own := level_of_detail(obj.name)) is not None:
        return own
    above = (level_of_detail(other.name) for other in ancestors(obj))
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


def _coincide(kept: Iterable[bpy.types.Object], others: Iterable[bpy.types.Object]) -> bool:
    (low, high), (other_low, other_high) = _box(kept), _box(others)
    apart = max(np.abs(low - other_low).max(), np.abs(high - other_high).max())
    return bool(apart < _SAME * (high - low).max())


def _box(objects: Iterable[bpy.types.Object]) -> tuple[FloatArray, FloatArray]:
    boxes = [box_of(obj) for obj in objects]
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)
