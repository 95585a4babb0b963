"""Registration of a module's classes, properties, handlers and timers with Blender.

The classes that a module defines are registered in their order, then `CLASSES`, which it makes in another way. A module
declares the rest by name: `POINTERS` are (Blender type, name, property group); `HANDLERS` maps names in
`bpy.app.handlers` to functions, which stay there when a file is loaded; `OVERLAYS` maps functions that draw in all 3D
Viewports to the moment when they do; `TIMERS` are functions that `watch` may have started. For anything else a module
defines `register`, which is called last, and `unregister`, which is called first.
"""

from collections.abc import Callable
from inspect import get_annotations
from types import ModuleType

import bpy
from bpy.props import PointerProperty

from .messages import CONTEXT

_overlays: dict[Callable[[], None], object] = {}
"""Blender's handles of the functions that draw."""


def register_module(module: ModuleType) -> None:
    """Register a module with Blender."""
    for cls in classes_of(module):
        _translate_in_context(cls)
        bpy.utils.register_class(cls)
    for owner, name, group in getattr(module, "POINTERS", ()):
        setattr(owner, name, PointerProperty(type=group, override={"LIBRARY_OVERRIDABLE"}))
    for name, handler in getattr(module, "HANDLERS", {}).items():
        getattr(bpy.app.handlers, name).append(bpy.app.handlers.persistent(handler))
    for draw, moment in getattr(module, "OVERLAYS", {}).items():
        _overlays[draw] = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", moment)
    if hasattr(module, "register"):
        module.register()


def classes_of(module: ModuleType) -> list[type]:
    """Return the classes of a module that Blender needs to know."""
    own = (cls for cls in vars(module).values() if getattr(cls, "__module__", "") == module.__name__)
    classes = [cls for cls in own if isinstance(cls, type) and issubclass(cls, bpy.types.bpy_struct)]
    return [*classes, *getattr(module, "CLASSES", ())]


def _translate_in_context(cls: type) -> None:
    """Let Blender look up the label of a class, and the names of its properties, in Facemime's context."""
    if issubclass(cls, (bpy.types.Operator, bpy.types.Panel, bpy.types.Menu)):
        cls.bl_translation_context = CONTEXT
    for base in cls.__mro__:
        for prop in get_annotations(base).values():
            if hasattr(prop, "keywords"):
                prop.keywords.setdefault("translation_context", CONTEXT)


def unregister_module(module: ModuleType) -> None:
    """Unregister a module from Blender."""
    if hasattr(module, "unregister"):
        module.unregister()
    for step in getattr(module, "TIMERS", ()):
        _unwatch(step)
    for name, handler in getattr(module, "HANDLERS", {}).items():
        getattr(bpy.app.handlers, name).remove(handler)
    for draw in getattr(module, "OVERLAYS", ()):
        bpy.types.SpaceView3D.draw_handler_remove(_overlays.pop(draw), "WINDOW")
    for owner, name, _ in getattr(module, "POINTERS", ()):
        delattr(owner, name)
    for cls in reversed(classes_of(module)):
        bpy.utils.unregister_class(cls)


def watch(step: Callable[[], float | None], seconds: float) -> None:
    """Start a timer, first after `seconds`, that also survives loading a file; does nothing if it is already running.

    `step` returns the seconds until it is called again, or None to stop.
    """
    if not bpy.app.timers.is_registered(step):
        bpy.app.timers.register(step, first_interval=seconds, persistent=True)


def _unwatch(step: Callable[[], float | None]) -> None:
    """Stop a timer; Blender 4.2 crashes if one is left when the extension is removed."""
    if bpy.app.timers.is_registered(step):
        bpy.app.timers.unregister(step)
