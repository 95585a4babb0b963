"""Operator that imports FaceGen heads."""

import bpy
from bpy.props import FloatProperty, StringProperty

from ..blender.heads.facegen import MILLIMETRE, import_facegen
from ..blender.meshes import keys_of, mesh_of
from .shared import AsksForFile, report, require_object_mode


class FACEMIME_OT_import_facegen(AsksForFile, bpy.types.Operator):
    """Import a FaceGen head: a .tri file with its morphs and the .egm file next to it, or an OBJ file"""

    bl_idname = "facemime.import_facegen"
    bl_label = "FaceGen Head (.tri, .obj)"

    filter_glob: StringProperty(default="*.tri;*.obj", options={"HIDDEN"})
    scale: FloatProperty(name="Scale", description="Metres per unit of the file", default=MILLIMETRE, min=1e-6)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require Object Mode."""
        return require_object_mode(cls, context)

    def work(self, context: bpy.types.Context) -> None:
        """Import the head."""
        obj = import_facegen(context, self.path, self.scale)
        keys = 0 if mesh_of(obj).shape_keys is None else len(keys_of(obj).key_blocks) - 1
        report(self, "{vertices} vertices, {keys} morphs", vertices=len(mesh_of(obj).vertices), keys=keys)


CLASSES = (FACEMIME_OT_import_facegen,)
