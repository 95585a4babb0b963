"""Undo steps, and the rule that must hold between two of them.

Blender's undo assumes that the open file equals the last step: data-blocks that are equal in two steps are not read
again and keep their pointers. If a data-block is created or removed without an undo step, pointers to freed memory
remain, and Blender crashes a few steps later. Values may change.
"""

from __future__ import annotations

import bpy

from .contexts import in_a_window


def push_undo(message: str) -> None:
    """Push an undo step, even from a timer or a handler, whose context has no window."""
    with in_a_window():
        if bpy.ops.ed.undo_push.poll():  # type: ignore[call-arg]  # the stubs have a class instead of its instance
            bpy.ops.ed.undo_push(message=message)
