"""Operators that add a built-in head, import FaceGen heads, and export heads for other programs."""

from collections.abc import Generator

import bpy
from bpy.app.translations import pgettext_rpt as _
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ..blender.animation.exporting import SUFFIX, export_gltf
from ..blender.heads.facegen import MILLIMETRE, add_facegen, import_facegen
from ..blender.heads.new_heads import add_head
from ..blender.meshes import mesh_of
from ..blender.view_layers import free_place
from ..sessions.session import Session
from .shared import (
    AsksForFiles,
    AsksForFileToWrite,
    heads_in,
    report,
    require_heads,
    require_no_session,
    require_object_mode,
)
from .steps import WorksInSteps


class FACEMIME_OT_add_head(WorksInSteps, bpy.types.Operator):
    """Add a head that is ready to be driven, with landmarks, regions, eyes, teeth and a tongue"""

    bl_idname = "facemime.add_head"
    bl_label = "Facemime Head"
    needs = (require_object_mode,)

    person: EnumProperty(
        name="Person",
        description="Head to add",
        items=(
            ("MAN", "Man", "A man with short hair"),
            ("WOMAN", "Woman", "A woman with hair combed back"),
            ("FACEGEN", "FaceGen", "Jane, a woman by FaceGen's makers, with her photographic skin and her own morphs"),
        ),
    )
    units: BoolProperty(name="ARKit Shape Keys (52)", description="Add the shape keys of ARKit, all at 0")
    show_textures: BoolProperty(
        name="Show Textures", description="Show the textures of skin and eyes in Solid shading", default=True
    )
    frame_view: BoolProperty(
        name="Frame in View", description="Frame the head, which is life-size, from the front", default=True
    )

    def status(self) -> str:
        return _("Facemime: adding the head")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Add the head at the 3D cursor, or beside the objects there, once the status bar says so."""
        yield 0.0
        if self.person == "FACEGEN":
            head = add_facegen(context)
        else:
            head = add_head(context, woman=self.person == "WOMAN", units=self.units)
        head.location = free_place(context, head, context.scene.cursor.location)
        space = context.space_data
        if isinstance(space, bpy.types.SpaceView3D):
            if space.local_view is not None:
                for obj in (head, *head.children_recursive):
                    obj.local_view_set(space, True)
            if self.show_textures and space.shading.color_type == "MATERIAL":
                space.shading.color_type = "TEXTURE"
            if self.frame_view:
                _frame_selected(context)


def _frame_selected(context: bpy.types.Context) -> None:
    """Frame the selection from the front, even when the operator was called from the Sidebar.

    While a puppet is running the view does not change: see `blender.contexts`.
    """
    if Session.running() is not None:
        return
    regions = () if context.area is None else context.area.regions
    view = next((region for region in regions if region.type == "WINDOW"), None)
    if view is not None:
        with context.temp_override(region=view):
            bpy.ops.view3d.view_axis(type="FRONT")
            bpy.ops.view3d.view_selected()


class FACEMIME_OT_import_facegen(AsksForFiles, bpy.types.Operator):
    """Import FaceGen heads: .tri files with their morphs, textures and .egm files, or OBJ files"""

    bl_idname = "facemime.import_facegen"
    bl_label = "FaceGen Head (.tri, .obj)"
    needs = (require_object_mode,)

    filter_glob: StringProperty(default="*.tri;*.obj", options={"HIDDEN"})
    beside: BoolProperty(
        name="Parts Beside It",
        description="Also import mouth, teeth, eyes and hair from the folder of a single head",
        default=True,
    )
    scale: FloatProperty(name="Scale", description="Metres per unit of the file", default=MILLIMETRE, min=1e-6)

    def work(self, context: bpy.types.Context) -> None:
        """Import the files."""
        objects = import_facegen(context, self.paths, self.scale, beside=self.beside)
        vertices = sum(len(mesh_of(obj).vertices) for obj in objects)
        head = mesh_of(objects[0])
        keys = 0 if head.shape_keys is None else len(head.shape_keys.key_blocks) - 1
        if len(objects) == 1:
            report(self, "{vertices} vertices, {keys} morphs", vertices=vertices, keys=keys)
            return
        report(
            self,
            "{objects} objects, {vertices} vertices, {keys} morphs",
            objects=len(objects),
            vertices=vertices,
            keys=keys,
        )


class FACEMIME_OT_export_gltf(AsksForFileToWrite, bpy.types.Operator):
    """Export the selected heads as glTF, with parts, bones, shape keys, and the frame range as one animation"""

    bl_idname = "facemime.export_gltf"
    bl_label = "Export glTF"
    needs = (require_object_mode, require_no_session, require_heads)

    filter_glob: StringProperty(default="*.glb", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Write the file."""
        path = self.path_ending(SUFFIX)
        export_gltf(heads_in(context), path)
        report(self, "Written to {path}", path=path)
