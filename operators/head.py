"""Operator that adds a built-in head."""

from collections.abc import Generator

import bpy
from bpy.app.translations import pgettext_rpt as _
from bpy.props import BoolProperty, EnumProperty

from ..blender.heads.built_in import add_head
from ..blender.placement import free_place
from ..sessions.session import Session
from .shared import require_object_mode
from .steps import WorksInSteps


class FACEMIME_OT_add_head(WorksInSteps, bpy.types.Operator):
    """Add a head that is ready to be driven, with landmarks, regions, eyes, teeth and a tongue"""

    bl_idname = "facemime.add_head"
    bl_label = "Facemime Head"

    person: EnumProperty(
        name="Person",
        description="Head to add",
        items=(("MAN", "Man", "A man with short hair"), ("WOMAN", "Woman", "A woman with hair combed back")),
    )
    units: BoolProperty(name="ARKit Shape Keys (52)", description="Add the shape keys of ARKit, all at 0")
    show_textures: BoolProperty(
        name="Show Textures", description="Show the textures of skin and eyes in Solid shading", default=True
    )
    frame_view: BoolProperty(
        name="Frame in View", description="Frame the head, which is life-size, from the front", default=True
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require Object Mode."""
        return require_object_mode(cls, context)

    def status(self) -> str:
        return _("Facemime: adding the head")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Add the head at the 3D cursor, or beside the objects there, once the status bar says so."""
        yield 0.0
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


CLASSES = (FACEMIME_OT_add_head,)
