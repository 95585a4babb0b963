"""Contexts in which operators are called.

An operator runs without Python's lock. Within `temp_override` it still looks members of the context up in a Python
dictionary, and up to Blender 5.0 (Python 3.11) it does not take the lock for that while another thread holds it. Memory
is then corrupted, and Blender crashes sooner or later. So the context is overridden only where an operator could not
run otherwise, and not while a session has threads.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import bpy


def in_a_window(window: bpy.types.Window | None = None) -> AbstractContextManager[object]:
    """Return a context manager within which operators run in a window.

    Parameters
    ----------
    window : bpy.types.Window, optional
        By default the one of the context; timers and handlers have none and get the first.
    """
    context = bpy.context
    windows = context.window_manager.windows
    wanted = window or context.window or (windows[0] if windows else None)
    return nullcontext() if wanted == context.window else context.temp_override(window=wanted)
