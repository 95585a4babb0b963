"""Bones of eyes: those that turn with one, and the control at which it looks, which animators move instead."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import bpy

from .meshes import posed_bones

_TRACKING = {"DAMPED_TRACK", "TRACK_TO", "LOCKED_TRACK"}
"""Constraints that turn a bone toward another one."""
_COPYING = {"COPY_LOCATION", "COPY_TRANSFORMS", "CHILD_OF"}
"""Constraints by which a bone is carried by another one."""
_TURNING = {"COPY_ROTATION", "COPY_TRANSFORMS", "CHILD_OF"}
"""Constraints by which a bone turns with another one."""
_SAME_POINT = 0.1
"""Distance between the heads of two bones, relative to the length of one, below which they are at the same point."""
_CARRIES = 0.5
"""Influence of a constraint from which it decides."""


class Aim(NamedTuple):
    """What an eye looks at: an object, or the bone of an armature that `bone` names."""

    obj: bpy.types.Object
    bone: str = ""


def aim_of(armature: bpy.types.Object, eye: str, head: str) -> Aim | None:
    """Return the control at which the bone of an eye looks, however it is turned; None without one.

    The control is free to move, and rides on the bone `head`, as the gaze of a performer is relative to the head.
    """
    first = posed_bones(armature)[eye]
    bone: bpy.types.PoseBone | None = first
    while bone is not None and _same_point(bone, first):
        for constraint in bone.constraints:
            if constraint.type in _TRACKING and (aim := _looked_at(constraint, armature, head)) is not None:
                return aim
        bone = bone.parent
    return None


def turned_by(armature: bpy.types.Object, name: str) -> list[str]:
    """Return the names of a bone and of those that turn with it: by a constraint, or below it about the same point, but
    not lids, nor what another constraint turns.
    """
    first, turned = posed_bones(armature)[name], [name]
    for leader in turned:  # which grows
        for other in posed_bones(armature):
            below = not other.constraints and other.parent is not None and other.parent.name == leader
            leads = (_leader(each, armature) for each in other.constraints if each.type in _TURNING)
            follows = any(bone is not None and bone.name == leader for bone in leads)
            if other.name not in turned and (follows or (below and _same_point(other, first))):
                turned.append(other.name)
    return turned


def looks_only(bone: bpy.types.PoseBone) -> bool:
    """Return whether a bone has constraints, all of which turn it toward something."""
    return bool(bone.constraints) and all(constraint.type in _TRACKING for constraint in bone.constraints)


def _looked_at(constraint: Any, armature: bpy.types.Object, head: str) -> Aim | None:
    """Return the control behind what a constraint tracks, if it can be moved and rides on the head."""
    if (leader := _leader(constraint, armature)) is not None:
        control = _control_of(leader, armature)
        return None if control is None or not _rides_on(control, head, armature) else Aim(armature, control.name)
    obj = constraint.target
    if constraint.mute or constraint.influence < _CARRIES or obj is None or constraint.subtarget:
        return None
    carrier = posed_bones(armature).get(obj.parent_bone) if obj.parent == armature else None
    free = obj.library is None and not obj.constraints and not any(obj.lock_location)
    rides = obj.parent_type == "BONE" and carrier is not None and _rides_on(carrier, head, armature)
    return Aim(obj) if free and rides else None


def _control_of(bone: bpy.types.PoseBone, armature: bpy.types.Object) -> bpy.types.PoseBone | None:
    """Return the bone that moves the given one and that nothing else moves; None if its location is locked."""
    seen: set[str] = set()
    while bone.name not in seen:
        seen.add(bone.name)
        leaders = [_leader(each, armature) for each in bone.constraints if each.type in _COPYING]
        above = bone.parent if bone.parent is not None and _same_point(bone.parent, bone) else None
        leader = next(filter(None, leaders), above if all(bone.lock_location) else None)
        if leader is None:
            break
        bone = leader
    return None if any(bone.lock_location) or bone.bone.use_connect else bone


def _leader(constraint: Any, armature: bpy.types.Object) -> bpy.types.PoseBone | None:
    """Return the bone of the same armature that a constraint names, if it decides."""
    if constraint.mute or constraint.influence < _CARRIES or constraint.target != armature:
        return None
    return posed_bones(armature).get(constraint.subtarget)


def _rides_on(bone: bpy.types.PoseBone, carrier: str, armature: bpy.types.Object) -> bool:
    """Return whether parents and constraints carry a bone along with another one."""
    seen, found = {bone.name}, [bone]
    for each in found:  # which grows
        new = [above for above in _carriers(each, armature) if above.name not in seen]
        seen.update(above.name for above in new)
        found += new
    return carrier in seen


def _carriers(bone: bpy.types.PoseBone, armature: bpy.types.Object) -> Iterator[bpy.types.PoseBone]:
    """Yield the bones that carry one: constraints replace what its parent does."""
    leaders = []
    for constraint in bone.constraints:
        if constraint.type in _COPYING and (leader := _leader(constraint, armature)) is not None:
            leaders.append(leader)
        elif constraint.type == "ARMATURE" and not constraint.mute and constraint.influence >= _CARRIES:
            every: Any = constraint
            weighted = [each for each in every.targets if each.weight >= _CARRIES and each.target == armature]
            leaders += [posed_bones(armature)[each.subtarget] for each in weighted if each.subtarget]
    if leaders:
        yield from leaders
    elif bone.parent is not None:
        yield bone.parent


def _same_point(one: bpy.types.PoseBone, other: bpy.types.PoseBone) -> bool:
    return (one.bone.head_local - other.bone.head_local).length <= _SAME_POINT * other.bone.length
