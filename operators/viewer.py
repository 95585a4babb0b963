"""Operators of the viewer in the browser."""

from __future__ import annotations

import bpy

from ..blender.stubs import OperatorMixin, OperatorResult
from .puppet import require_puppet, required_puppet
from .shared import report, require


class _OfViewer(OperatorMixin):
    """Mixin: needs a running viewer."""

    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet with a viewer."""
        return require_puppet(cls) and require(
            cls, required_puppet().displays.viewer is not None, "Enable the viewer first"
        )


def _address() -> str:
    viewer = required_puppet().displays.viewer
    assert viewer is not None, "poll requires it"
    return viewer.address


class FACEMIME_OT_open_viewer(_OfViewer, bpy.types.Operator):
    """Open the viewer in this computer's browser"""

    bl_idname = "facemime.open_viewer"
    bl_label = "Open in Browser"

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Open the page."""
        bpy.ops.wm.url_open(url=_address())
        return {"FINISHED"}


class FACEMIME_OT_copy_viewer_address(_OfViewer, bpy.types.Operator):
    """Copy the address of the viewer; anyone who has it can watch"""

    bl_idname = "facemime.copy_viewer_address"
    bl_label = "Copy Address"

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Copy the address to the clipboard."""
        context.window_manager.clipboard = _address()
        report(self, "Address copied to the clipboard")
        return {"FINISHED"}


CLASSES = (FACEMIME_OT_open_viewer, FACEMIME_OT_copy_viewer_address)
