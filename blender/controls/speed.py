"""How long a rig takes to be evaluated, and which are too slow to be driven live."""

from __future__ import annotations

import time
from statistics import median

import bpy
import numpy as np

from ...core.errors import Message
from ...core.rigs.rig_map import RigMap
from .setting import held
from .stored import rig_group
from .view import look_at

TOO_SLOW = 0.05
"""Seconds of an evaluation above which a puppet shows fewer than some 15 frames per second, as each is evaluated and
drawn.
"""
_EVALUATIONS = 5


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
