"""Contexts in which operators are called, and undo steps.

An operator runs without Python's lock. Within `temp_override` it still looks members of the context up in a Python
dictionary, and up to Blender 5.0 (Python 3.11) it does not take the lock for that while another thread holds it. Memory
is then corrupted, and Blender crashes sooner or later. So the context is overridden only where an operator could not
run otherwise, and not while a session has threads.

Blender's undo assumes that the open file equals the last step: data-blocks that are equal in two steps are not read
again and keep their pointers. If a data-block is created or removed without an undo step, pointers to freed memory
remain, and Blender crashes a few steps later. Values may change.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import bpy

from ..core.errors import HeadError


def in_a_window(window: bpy.types.Window | None = None) -> AbstractContextManager[object]:
    """Return a context manager within which operators run in a window, by default that of the context.

    Timers and handlers have none and get the first.
    """
    context = bpy.context
    windows = context.window_manager.windows
    wanted = window or context.window or (windows[0] if windows else None)
    return nullcontext() if wanted == context.window else context.temp_override(window=wanted)


def evaluated_depsgraph(context: bpy.types.Context) -> bpy.types.Depsgraph:
    """Return the dependency graph of the view layer, evaluated.

    The one from `Context.evaluated_depsgraph_get` may crash a function that it is passed to: once Sculpt Mode has been
    entered in Blender 4.3, it refers to that scene, even after its file was closed.
    """
    context.evaluated_depsgraph_get()
    graph = context.view_layer.depsgraph
    assert graph is not None, "it has just been evaluated"
    return graph


def scene_of(obj: bpy.types.Object) -> bpy.types.Scene:
    """Return the scene that has an object, that of the context if it does; raises HeadError if no scene has it."""
    current = bpy.context.scene
    if obj.name in current.objects and current.objects[obj.name] == obj:
        return current
    if obj.users_scene:
        return obj.users_scene[0]
    raise HeadError("{name} is in no scene. Link it to a collection of a scene.", name=obj.name)


def find_scene(uid: int) -> bpy.types.Scene | None:
    """Return the scene with a `session_uid`, which it keeps when it is renamed or an undo reads it again; None if it
    was deleted.
    """
    return next((scene for scene in bpy.data.scenes if scene.session_uid == uid), None)


@contextmanager
def showing_scene(scene: bpy.types.Scene) -> Iterator[None]:
    """Show a scene for a while, so that the context has it: its objects are evaluated and operators find them."""
    window = bpy.context.window or next(iter(bpy.context.window_manager.windows), None)
    before = None if window is None else window.scene
    if window is None or before in (None, scene):
        yield
        return
    window.scene = scene
    try:
        yield
    finally:
        window.scene = before


def push_undo(message: str) -> None:
    """Push an undo step, even from a timer or a handler, whose context has no window."""
    with in_a_window():
        if bpy.ops.ed.undo_push.poll():  # type: ignore[call-arg]  # the stubs have a class instead of its instance
            bpy.ops.ed.undo_push(message=message)
