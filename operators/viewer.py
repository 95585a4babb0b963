"""Operators of the viewer in the browser."""

from __future__ import annotations

import bpy

from .puppet import require_puppet, running
from .shared import report, require


class _OfViewer:
    """Mixin: needs a running viewer."""

    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet with a viewer."""
        return require_puppet(cls) and require(cls, running().viewer is not None, "Enable the viewer first")


class FACEMIME_OT_open_viewer(_OfViewer, bpy.types.Operator):
    """Open the viewer in this computer's browser"""

    bl_idname = "facemime.open_viewer"
    bl_label = "Open in Browser"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open the page."""
        return bpy.ops.wm.url_open(url=running().viewer.address)


class FACEMIME_OT_copy_viewer_address(_OfViewer, bpy.types.Operator):
    """Copy the address of the viewer; anyone who has it can watch"""

    bl_idname = "facemime.copy_viewer_address"
    bl_label = "Copy Address"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy the address to the clipboard."""
        context.window_manager.clipboard = running().viewer.address
        report(self, "Address copied to the clipboard")
        return {"FINISHED"}


CLASSES = (FACEMIME_OT_open_viewer, FACEMIME_OT_copy_viewer_address)
