"""What keeps a baked or live pose from being seen: hidden heads, armatures in Rest Position, and constraints."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ...core.errors import Message
from ..armatures import armature_data
from .targets import PoseTarget

_ROTATIONS = {"COPY_ROTATION", "COPY_TRANSFORMS", "TRACK_TO", "DAMPED_TRACK", "LOCKED_TRACK", "LIMIT_ROTATION", "IK"}
_ROTATIONS |= {"ARMATURE", "SPLINE_IK", "TRANSFORM", "TRANSFORM_CACHE", "ACTION"}
_LOCATIONS = {"COPY_LOCATION", "COPY_TRANSFORMS", "LIMIT_LOCATION", "FOLLOW_PATH", "CLAMP_TO", "TRANSFORM_CACHE"}
"""Constraints that change the rotation and the location."""
_ADDING = {"ADD", "BEFORE", "AFTER", "BEFORE_FULL", "AFTER_FULL", "BEFORE_SPLIT", "AFTER_SPLIT"}
"""Mix modes with which a constraint adds to the pose."""


def overruled(targets: Iterable[PoseTarget], *, rotation: bool, translation: bool) -> list[str]:
    """Return warnings that name what keeps the pose of some targets from being seen.

    Parameters
    ----------
    rotation, translation : bool
        Whether they are rotated and moved.
    """
    targets = list(targets)
    resting = dict.fromkeys(target.obj for target in targets if target.bone and _rests(target.obj))
    warnings: list[str] = []
    for armature in resting:
        warnings.append(
            Message(
                "{name} is in Rest Position, which hides the pose of its bones. Set it to Pose Position in the "
                "Armature tab.",
                name=armature.name,
            )
        )
    kinds = (_ROTATIONS if rotation else set()) | (_LOCATIONS if translation else set())
    found = dict.fromkeys(
        f"{target.owner.name} ({constraint.name})"
        for target in targets
        for constraint in target.owner.constraints
        if constraint.type in kinds and _overrules(constraint)
    )
    if found:
        names = ", ".join(found)
        warnings.append(Message("Constraints override the pose: {names}. Mute them to show it.", names=names))
    return warnings


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


def _rests(armature: bpy.types.Object) -> bool:
    return bool(armature_data(armature).pose_position == "REST")


def _overrules(constraint: bpy.types.Constraint) -> bool:
    """Return whether a constraint works and does not only add to what is there."""
    adds = getattr(constraint, "mix_mode", "") in _ADDING or getattr(constraint, "use_offset", False)
    return not constraint.mute and constraint.influence > 0.0 and not adds
