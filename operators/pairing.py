"""Operators of the pairing line, by which a computer in another network receives the performance."""

from __future__ import annotations

import bpy

from ..core.streams.transport.identity import renew_identity
from ..settings.pairing import pairing_folder, pairing_line
from .puppet import running
from .shared import ReportsErrors, report, require


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
        renew_identity(pairing_folder())
        report(self, "Earlier pairing lines are no longer valid: copy the new one")


CLASSES = (FACEMIME_OT_copy_pairing_line, FACEMIME_OT_renew_pairing_line)
