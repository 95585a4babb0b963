"""What follows the pose of a head that no bone turns, and what else carries it."""

from __future__ import annotations

import bpy

from ..characters import ancestors, objects_of
from .targets import PoseTarget


def carried_targets(head: bpy.types.Object, target: PoseTarget) -> list[PoseTarget]:
    """Return the targets of the head's pose: `target` and, if that is the head itself, also its other objects."""
    if target.obj != head:
        return [target]
    objects = set(objects_of(head))
    loose = [obj for obj in objects_of(head) if not objects.union({head}).intersection(ancestors(obj))]
    return [target, *(PoseTarget(obj, head=head, pivot=target.pivot or (0.0, 0.0, 0.0)) for obj in loose)]


def carriers_of(head: bpy.types.Object, target: PoseTarget) -> list[bpy.types.Object]:
    """Return what carries only some of the objects of `carried_targets`, such as a parent that turns an eye.

    The pose of these objects holds only while they are where they were.
    """
    shared = {head, *ancestors(head)}
    loose = carried_targets(head, target)[1:]
    return list(dict.fromkeys(above for carried in loose for above in ancestors(carried.obj) if above not in shared))
