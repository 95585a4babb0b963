"""What Blender is told of a module, and forgets again: classes, properties of its types, handlers, timers.

A module says so by its names. `CLASSES` are registered in their order; `POINTERS` are (type of Blender's, name,
property group); `HANDLERS` maps the names of `bpy.app.handlers` to functions; `TIMERS` are functions that `watch` may
have started. Whatever is left, a module does in `register`, which comes last, and in `unregister`, which comes first.
"""

from collections.abc import Callable
from types import ModuleType

import bpy
from bpy.props import PointerProperty


def register_module(module: ModuleType) -> None:
    """Tell Blender of a module."""
    for cls in getattr(module, "CLASSES", ()):
        bpy.utils.register_class(cls)
    for owner, name, group in getattr(module, "POINTERS", ()):
        setattr(owner, name, PointerProperty(type=group))
    for name, handler in getattr(module, "HANDLERS", {}).items():
        getattr(bpy.app.handlers, name).append(handler)
    if hasattr(module, "register"):
        module.register()


def unregister_module(module: ModuleType) -> None:
    """Let Blender forget a module."""
    if hasattr(module, "unregister"):
        module.unregister()
    for step in getattr(module, "TIMERS", ()):
        unwatch(step)
    for name, handler in getattr(module, "HANDLERS", {}).items():
        getattr(bpy.app.handlers, name).remove(handler)
    for owner, name, _ in getattr(module, "POINTERS", ()):
        delattr(owner, name)
    for cls in reversed(getattr(module, "CLASSES", ())):
        bpy.utils.unregister_class(cls)


def watch(step: Callable[[], float | None], seconds: float) -> None:
    """Let Blender call `step` after `seconds` and as it then asks, whatever file is open; asked twice, it is one."""
    if not bpy.app.timers.is_registered(step):
        bpy.app.timers.register(step, first_interval=seconds, persistent=True)


def unwatch(step: Callable[[], float | None]) -> None:
    """Call it no longer: Blender 4.2 ends in a crash where a timer still waits, or was dropped with its file."""
    if bpy.app.timers.is_registered(step):
        bpy.app.timers.unregister(step)
