"""Which camera is used."""

import bpy
from bpy.props import StringProperty

from ..settings.preferences import preferences


class FACEMIME_OT_choose_camera(bpy.types.Operator):
    """Use this camera; it is kept in the preferences"""

    bl_idname = "facemime.choose_camera"
    bl_label = "Choose Camera"
    bl_options = {"INTERNAL"}

    camera: StringProperty(name="Camera")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Keep it."""
        preferences().camera = self.camera
        context.preferences.is_dirty = True
        return {"FINISHED"}


CLASSES = (FACEMIME_OT_choose_camera,)
