"""Undo steps, and what has to hold between two of them.

Blender's undo takes for granted that the open file is what the last step has stored: data-blocks that are equal in two
steps are not read again, and keep their pointers. A data-block that was made or removed since the last step without a
step of its own leaves pointers to freed memory, on which Blender ends some steps later. Values may differ.
"""

from __future__ import annotations

import bpy


def push_undo(message: str) -> None:
    """An undo step, also from a timer or a handler, which have no window of their own."""
    windows = bpy.context.window_manager.windows
    with bpy.context.temp_override(window=windows[0]) if windows else bpy.context.temp_override():
        if bpy.ops.ed.undo_push.poll():
            bpy.ops.ed.undo_push(message=message)
