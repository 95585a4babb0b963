"""Controls of a character's own rig, learnt inside Blender for `facemime bind` and `facemime puppet`."""

from __future__ import annotations

from contextlib import closing

import bpy

from ..blender import control_properties
from ..blender.controls.probing import Learning
from ..blender.controls.speed import measure_speed
from ..blender.controls.stored import are_known, require_storable, rig_group, write_controls
from ..blender.heads.parts import ensure_bones
from ..core.rigs.rig_map import RigMap
from .console import Progress, tell
from .stopping import STOPPING


def learn(head: bpy.types.Object) -> RigMap:
    """Learn the controls of a head, and store them with it; raises HeadError if none moves its face."""
    control_properties.ensure_registered()
    require_storable(head)
    ensure_bones(head)
    with closing(Learning(head)) as learning:
        progress = Progress(f"Learning the controls of {head.name}", learning.total, unit="channels")
        for _ in learning.steps():
            STOPPING.check()
            progress.update(learning.done)
        progress.finish()
        found = learning.result()
    write_controls(head, found)
    measure_speed(head, found)
    tell(f"{len(found.controls)} controls found; they can show {round(100.0 * rig_group(head).shown)} %")
    return found


def ensure_learnt(head: bpy.types.Object) -> None:
    """Learn the controls of a head unless they are known, and the rig is as it was then."""
    if not are_known(head):
        learn(head)
