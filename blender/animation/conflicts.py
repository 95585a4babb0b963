"""What conflicts with a bake: what keeps its pose from being seen, and animation of shape keys that would play in
addition.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import bpy
import numpy as np

from ...core.drive.driver import HeadMotion
from ...core.errors import Message
from ..characters import Member, members_of, objects_of
from ..controls.finding import is_resting
from ..meshes import key_names, key_offsets, keys_of, mesh_of
from ..muting import Silenced, mute_others, mute_paths, others_playing
from .bake_keys import family_keys, moved_paths, value_path
from .targets import PoseTarget

_ROTATIONS = {"COPY_ROTATION", "COPY_TRANSFORMS", "TRACK_TO", "DAMPED_TRACK", "LOCKED_TRACK", "LIMIT_ROTATION", "IK"}
_STILL = 1e-6
"""Largest motion of a vertex that does not move, in the unit of the head."""


_ROTATIONS |= {"ARMATURE", "SPLINE_IK", "TRANSFORM", "TRANSFORM_CACHE", "ACTION"}
_LOCATIONS = {"COPY_LOCATION", "COPY_TRANSFORMS", "LIMIT_LOCATION", "FOLLOW_PATH", "CLAMP_TO", "TRANSFORM_CACHE"}
"""Constraints that change the rotation and the location."""
_ADDING = {"ADD", "BEFORE", "AFTER", "BEFORE_FULL", "AFTER_FULL", "BEFORE_SPLIT", "AFTER_SPLIT"}
"""Mix modes with which a constraint adds to the pose."""


def overruled(
    targets: Iterable[PoseTarget], *, rotation: bool, translation: bool, rigs: Iterable[bpy.types.Object] = ()
) -> list[str]:
    """Return warnings that name what keeps the pose of targets that are rotated or moved from being seen.

    `rigs` are objects whose controls are moved.
    """
    targets = list(targets)
    posed = dict.fromkeys([*(target.obj for target in targets if target.bone), *rigs])
    resting = [obj for obj in posed if is_resting(obj)]
    warnings: list[str] = [
        Message(
            "{name} is in Rest Position, which hides the pose of its bones. "
            "Set it to Pose Position in the Armature tab.",
            name=armature.name,
        )
        for armature in resting
    ]
    found = dict.fromkeys(
        f"{target.owner.name} ({constraint.name})"
        for target in targets
        for constraint in target.owner.constraints
        if constraint.type in _overruling(target, rotation=rotation, translation=translation) and _overrules(constraint)
    )
    if found:
        names = ", ".join(found)
        warnings.append(Message("Constraints override the pose: {names}. Mute them to show it.", names=names))
    return warnings


def _overruling(target: PoseTarget, *, rotation: bool, translation: bool) -> set[str]:
    """Return the types of constraints that change what a target's pose is given."""
    turns, moves = rotation and not target.looking, translation or (rotation and bool(target.looking))
    return (_ROTATIONS if turns else set()) | (_LOCATIONS if moves else set())


def unseen(heads: Iterable[bpy.types.Object]) -> list[str]:
    """Return a warning that names the heads which the view layer hides, if there are any."""
    names = ", ".join(head.name for head in heads if not head.visible_get())
    if not names:
        return []
    return [
        Message(
            "Hidden: {names}. Show it, or enable its collection, in the Outliner to see the animation.", names=names
        )
    ]


def _overrules(constraint: bpy.types.Constraint) -> bool:
    """Return whether a constraint works and does not only add to what is there."""
    adds = getattr(constraint, "mix_mode", "") in _ADDING or getattr(constraint, "use_offset", False)
    return not constraint.mute and constraint.influence > 0.0 and not adds


def playing_under(head: bpy.types.Object) -> list[str]:
    """Return the names of actions and NLA tracks that move shape keys of a character in addition to a bake."""
    return list(dict.fromkeys(name for keys in _shape_keys(head) for name in others_playing(keys)))


def mute_under(head: bpy.types.Object) -> int:
    """Mute the animation that `playing_under` names, and return how many curves and tracks were muted."""
    return sum(len(mute_others(keys)) for keys in _shape_keys(head))


def mute_disturbing(head: bpy.types.Object, motion: HeadMotion, *, drivers: bool = True) -> list[Silenced]:
    """Mute what animates shape keys of a head that move the same vertices as a bake, and return what that was.

    `drivers` is whether drivers are muted too, by which the controls of a rig may move the keys.
    """
    members, silenced = members_of(head), []
    family = family_keys(members)
    for member in members:
        if (keys := mesh_of(member.obj).shape_keys) is None:
            continue
        driven = moved_paths(keys, family) if drivers else set()
        if driven or others_playing(keys):  # usually nothing else moves a head
            paths = _moving_the_same(member, motion)
            silenced += [*mute_others(keys, paths), *mute_paths(keys, paths & driven, curves=False)]
    return silenced


def _moving_the_same(member: Member, motion: HeadMotion) -> set[str]:
    """Return the data paths of the user's keys of a mesh that move vertices which a motion moves."""
    own = motion.vertices[:, member.part]
    moved = np.maximum(own.max(axis=0, initial=0.0), -own.min(axis=0, initial=0.0)).max(axis=1) > _STILL
    blocks = keys_of(member.obj).key_blocks
    offsets = {name: np.abs(key_offsets(blocks[name])[moved]) for name in key_names(member.obj)}
    return {value_path(name) for name, of in offsets.items() if of.max(initial=0.0) > _STILL}


def _shape_keys(head: bpy.types.Object) -> Iterator[bpy.types.Key]:
    for obj in (head, *objects_of(head)):
        if (keys := mesh_of(obj).shape_keys) is not None:
            yield keys
