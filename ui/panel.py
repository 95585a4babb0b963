"""The sidebar's tab Facemime."""

import bpy


class FACEMIME_PT_puppet(bpy.types.Panel):
    """Head, settings and the button that puppets it."""

    bl_label = "Facemime"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Facemime"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.facemime
        layout.operator("facemime.add_head", text="Add Head", icon="MONKEY")
        layout.operator("facemime.puppet_video", icon="FILE_MOVIE")
        column = layout.column(heading="Head Pose")
        column.prop(settings, "rotation", text="Rotation")
        column.prop(settings, "translation", text="Location")
        column.prop(settings, "pose_object", text="On")
        column = layout.column(align=True, heading="Neutral")
        column.prop(settings, "find_neutral", text="Find")
        row = column.row()
        row.active = not settings.find_neutral
        row.prop(settings, "neutral", text="At")
        column = layout.column(align=True)
        column.label(text="Strength")
        column.prop(settings, "strength_upper", text="Upper")
        column.prop(settings, "strength_middle", text="Middle")
        column.prop(settings, "strength_lower", text="Lower")
        layout.prop(settings, "mode")
        layout.prop(settings, "kernel")


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(FACEMIME_PT_puppet)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(FACEMIME_PT_puppet)
