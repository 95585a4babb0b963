"""Operator that exports heads and their animation for other programs."""

import bpy
from bpy.props import StringProperty

from ..blender.animation.gltf import SUFFIX, export_gltf
from .shared import AsksForFileToWrite, heads_in, report, require_heads, require_no_session, require_object_mode


class FACEMIME_OT_export_gltf(AsksForFileToWrite, bpy.types.Operator):
    """Export the selected heads as glTF, with parts, bones, shape keys, and the frame range as one animation"""

    bl_idname = "facemime.export_gltf"
    bl_label = "Export glTF"

    filter_glob: StringProperty(default="*.glb", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require Object Mode, a head, and that no puppet moves it."""
        return require_object_mode(cls, context) and require_no_session(cls) and require_heads(cls, context)

    def work(self, context: bpy.types.Context) -> None:
        """Write the file."""
        path = self.path_ending(SUFFIX)
        export_gltf(heads_in(context), path)
        report(self, "Written to {path}", path=path)


CLASSES = (FACEMIME_OT_export_gltf,)
