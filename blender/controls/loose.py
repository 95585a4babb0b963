"""Parts of a face that its rig does not move, such as lashes and hair that were never bound to it."""

from __future__ import annotations

import bpy

from ...core.errors import Message
from ..characters import objects_of, parts_of
from ..fcurves import drivers_of
from ..meshes import mesh_of

_BINDING = {"ARMATURE", "LATTICE", "MESH_DEFORM", "SURFACE_DEFORM", "HOOK", "CORRECTIVE_SMOOTH", "CLOTH", "SOFT_BODY"}
"""Modifiers by which a mesh follows bones or a mesh that bones move."""


def loose_parts(head: bpy.types.Object) -> str:
    """Return a warning that names the parts that stay behind when the rig that deforms a head moves; "" without any."""
    if not any(modifier.type == "ARMATURE" for modifier in head.modifiers):
        return ""
    parts = dict.fromkeys([*objects_of(head), *parts_of(head).values()])
    names = [obj.name for obj in parts if obj.visible_get() and not _follows(obj, head)]
    if not names:
        return ""
    return Message(
        "Not bound to the rig, so that they stay behind when it moves: {names}. Parent them to a bone, or give them "
        "weights and an Armature modifier.",
        names=", ".join(names),
    )


def _follows(obj: bpy.types.Object, head: bpy.types.Object) -> bool:
    """Return whether anything lets an object follow a rig: a modifier, constraint, driver or parent."""
    if any(modifier.type in _BINDING for modifier in obj.modifiers) or len(obj.constraints):
        return True
    keys = mesh_of(obj).shape_keys if obj.type == "MESH" else None
    if keys is not None and any(True for _ in drivers_of(keys)):
        return True
    if obj.parent is None or obj.parent == head:
        return False
    return obj.parent_type != "OBJECT" or _follows(obj.parent, head)
