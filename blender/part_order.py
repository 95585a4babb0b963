"""The order of the meshes of a face, on which what is taught and learnt about their vertices depends."""

from __future__ import annotations

import bpy

from .characters import objects_of
from .names import HEAD_PROPERTY, ORDER_PROPERTY


def keep_order(head: bpy.types.Object) -> None:
    """Let the meshes of a face have the order that they have now, also when they are renamed or copied.

    Linked meshes keep the names of their file.
    """
    for place, obj in enumerate(objects_of(head)):
        if obj.is_editable and obj.get(ORDER_PROPERTY) != place:
            obj[ORDER_PROPERTY] = place


def remove_from_character(obj: bpy.types.Object) -> None:
    """Let a mesh belong to no head any longer."""
    for name in (HEAD_PROPERTY, ORDER_PROPERTY):
        if name in obj:
            del obj[name]
