"""Warnings about the rig of a head: parts that it does not move, such as lashes and hair that were never bound to it,
and that it is too slow to be driven live.
"""

from __future__ import annotations

import time
from statistics import median

import bpy
import numpy as np

from ...core.errors import Message
from ...core.rigs.rig_map import RigMap
from ..characters import objects_of, parts_of
from ..fcurves import drivers_of
from ..meshes import mesh_of
from .setting import held
from .stored import rig_group
from .view import look_at

_BINDING = {"ARMATURE", "LATTICE", "MESH_DEFORM", "SURFACE_DEFORM", "HOOK", "CORRECTIVE_SMOOTH", "CLOTH", "SOFT_BODY"}
"""Modifiers by which a mesh follows bones or a mesh that bones move."""
TOO_SLOW = 0.05
"""Seconds of an evaluation above which a puppet shows fewer than some 15 frames per second, as each is evaluated and
drawn.
"""
_EVALUATIONS = 5


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


def measure_speed(head: bpy.types.Object, found: RigMap) -> None:
    """Store how long the rig of a head takes to be evaluated; afterwards every channel is what it was."""
    seconds = []
    with held(found.channels) as controls:
        for number in range(_EVALUATIONS):
            controls.write(found.values(np.full(len(found.channel), 1e-3 * (number + 1)) * found.upper.clip(0.0, 1.0)))
            start = time.perf_counter()
            look_at(head, found.sample)
            seconds.append(time.perf_counter() - start)
    rig_group(head).seconds = median(seconds)


def slowness(head: bpy.types.Object) -> str:
    """Return a warning if the rig of a head is too slow to be driven live; "" if it is not."""
    group = rig_group(head)
    if group is None or group.seconds <= TOO_SLOW:
        return ""
    return Message(
        "The rig of {name} takes {time:.0f} ms per frame, which is too slow to be driven live. Bake to it instead.",
        name=head.name,
        time=1e3 * group.seconds,
    )
