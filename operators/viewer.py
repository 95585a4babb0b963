"""Operators of the viewer in the browser, and of the pairing line of receivers in other networks."""

from __future__ import annotations

import bpy

from ..blender.stubs import OperatorMixin, OperatorResult
from ..settings.properties import pairing_line, renew_pairing_line
from .puppet import require_puppet, required_puppet, running
from .shared import ReportsErrors, report, require


class _OfViewer(OperatorMixin):
    """Mixin: needs a running viewer."""

    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet with a viewer."""
        there = require_puppet(cls, context)
        return there and require(cls, required_puppet().displays.viewer is not None, "Enable the viewer first")


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


class FACEMIME_OT_copy_pairing_line(ReportsErrors, bpy.types.Operator):
    """Copy the line that the other computer needs to receive the performance; anyone who has it can"""

    bl_idname = "facemime.copy_pairing_line"
    bl_label = "Copy Pairing Line"
    bl_options = {"INTERNAL"}

    def work(self, context: bpy.types.Context) -> None:
        """Copy the line to the clipboard."""
        context.window_manager.clipboard = pairing_line(context.scene.facemime.output)
        report(self, "Pairing line copied to the clipboard")


class FACEMIME_OT_renew_pairing_line(ReportsErrors, bpy.types.Operator):
    """Make a new pairing line; computers with the previous one can no longer receive"""

    bl_idname = "facemime.renew_pairing_line"
    bl_label = "Renew Pairing Line"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require that no puppet sends with the previous one."""
        return require(cls, running() is None, "Stop the puppet first")

    def work(self, context: bpy.types.Context) -> None:
        """Replace the certificate and the token."""
        renew_pairing_line()
        report(self, "Earlier pairing lines are no longer valid: copy the new one")
