"""Armatures that another one carries or leads, as the rig of a body does with that of its face."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..core.heads.part_names import find_bones
from .meshes import posed_bones
from .own_pose import Posable

_LEADING = {"COPY_TRANSFORMS", "COPY_ROTATION", "CHILD_OF", "ARMATURE"}
"""Constraints by which something turns with the bone of another armature."""
_Place = tuple[bpy.types.Object, str]


def turning(armature: bpy.types.Object, bone: str) -> _Place:
    """Return the armature and the bone that turn a head: those given, unless the head of another armature moves them.

    Its hair, hat and neck may follow that one only.
    """
    seen = {armature}
    while (above := next(_above(armature, bone), None)) is not None and above[0] not in seen:
        armature, bone = above
        seen.add(armature)
    return armature, bone


def follows_head(bone: bpy.types.PoseBone) -> bool:
    """Return whether the bone of a head in another armature leads a bone."""
    return next(_leaders(bone), None) is not None


def _above(armature: bpy.types.Object, name: str) -> Iterator[_Place]:
    """Yield the heads in other armatures that lead or carry a bone."""
    if (bone := posed_bones(armature).get(name)) is None:
        return
    for one in (bone, *bone.parent_recursive):
        yield from _leaders(one)
    obj: bpy.types.Object | None = armature
    while obj is not None:
        yield from _leaders(obj)
        if obj.parent_type == "BONE" and obj.parent is not None and _is_head(obj.parent, obj.parent_bone):
            yield obj.parent, obj.parent_bone
        obj = obj.parent


def _leaders(owner: Posable) -> Iterator[_Place]:
    """Yield the heads in other armatures to which constraints bind an object or a bone."""
    for constraint in owner.constraints:
        if constraint.type in _LEADING and not constraint.mute and constraint.influence > 0.0:
            for target in getattr(constraint, "targets", None) or [constraint]:
                leader, name = getattr(target, "target", None), getattr(target, "subtarget", "")
                if leader is not None and leader != owner.id_data and _is_head(leader, name):
                    yield leader, name


def _is_head(obj: bpy.types.Object, bone: str) -> bool:
    """Return whether a name is that of the bone of a head which can be posed."""
    known = obj.type == "ARMATURE" and obj.library is None and bone in posed_bones(obj)
    return known and find_bones([bone], {}).head == bone
