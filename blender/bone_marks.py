"""Marks on bones, by which they are found again after they were renamed.

Blender renames the vertex groups, constraints and animation of a bone along with it, but no custom property that has
its name. A mark is a line of a custom property of the bone, which copies of the armature have, too.
"""

from __future__ import annotations

import bpy

from .meshes import posed_bones
from .names import BONE_MARKS_PROPERTY


def marks_of(bone: bpy.types.PoseBone) -> list[str]:
    """Return the marks of a bone."""
    return str(bone.get(BONE_MARKS_PROPERTY, "")).split("\n")


def mark_bone(armature: bpy.types.Object, name: str, mark: str) -> None:
    """Mark the bone with a name, and no other; does nothing to a linked armature, whose bones cannot be renamed."""
    if armature.library is not None:
        return
    for bone in posed_bones(armature):
        kept = [one for one in marks_of(bone) if one not in ("", mark)]
        wanted = [*kept, mark] if bone.name == name else kept
        if wanted:
            bone[BONE_MARKS_PROPERTY] = "\n".join(wanted)
        elif BONE_MARKS_PROPERTY in bone:
            del bone[BONE_MARKS_PROPERTY]


def marked_bone(armature: bpy.types.Object, name: str, mark: str) -> str:
    """Return the present name of the bone with a mark, or "" if there is none.

    Of several with the mark, the one with `name` is meant; that one is also meant if no bone has the mark. `mark` is ""
    in files of earlier versions.
    """
    bones = posed_bones(armature)
    if name in bones and (not mark or mark in marks_of(bones[name])):
        return name
    if not mark:
        return ""
    return next((bone.name for bone in bones if mark in marks_of(bone)), name if name in bones else "")
