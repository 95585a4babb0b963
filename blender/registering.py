"""Classes and timers that Blender is told of, and that it forgets again."""

from collections.abc import Callable

import bpy


def watch(step: Callable[[], float | None], seconds: float) -> None:
    """Let Blender call `step` after `seconds` and as it then asks, whatever file is open; asked twice, it is one."""
    if not bpy.app.timers.is_registered(step):
        bpy.app.timers.register(step, first_interval=seconds, persistent=True)


def unwatch(step: Callable[[], float | None]) -> None:
    """Call it no longer: Blender 4.2 ends in a crash where a timer still waits, or was dropped with its file."""
    if bpy.app.timers.is_registered(step):
        bpy.app.timers.unregister(step)


def register_all(classes: tuple[type, ...]) -> None:
    """Register `classes` in their order."""
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister_all(classes: tuple[type, ...]) -> None:
    """Unregister `classes`, the last first."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
