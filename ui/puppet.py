"""The last step: a performance moves the head."""

import bpy

from .sidebar import Sidebar, place


class FACEMIME_PT_puppet(Sidebar, bpy.types.Panel):
    """The button that puppets the head, and what its pose goes to."""

    bl_label = "Puppet"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.facemime
        layout.operator("facemime.puppet_video", icon="FILE_MOVIE")
        column = layout.column(heading="Head Pose")
        column.prop(settings, "rotation", text="Rotation")
        column.prop(settings, "translation", text="Location")
        column.prop(settings.posing, "object", text="On")
        column = layout.column(align=True, heading="Neutral")
        column.prop(settings, "find_neutral", text="Find")
        row = column.row()
        row.active = not settings.find_neutral
        row.prop(settings, "neutral", text="At")


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(FACEMIME_PT_puppet)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(FACEMIME_PT_puppet)
