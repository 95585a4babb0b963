"""Operator behind the menu of cameras."""

import bpy
from bpy.props import StringProperty

from ..blender.stubs import OperatorResult
from ..settings.preferences import preferences


class FACEMIME_OT_choose_camera(bpy.types.Operator):
    """Use this camera and save it in the preferences"""

    bl_idname = "facemime.choose_camera"
    bl_label = "Choose Camera"
    bl_options = {"INTERNAL"}

    camera: StringProperty(name="Camera")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Store the camera in the preferences."""
        preferences().camera = self.camera
        context.preferences.is_dirty = True
        return {"FINISHED"}


CLASSES = (FACEMIME_OT_choose_camera,)
