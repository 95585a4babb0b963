"""How strongly a performance moves each part of the face, and how the skin follows."""

import bpy

from .sidebar import Sidebar, place


class FACEMIME_PT_expression(Sidebar, bpy.types.Panel):
    """Strength of the regions, depth and skin."""

    bl_label = "Expression"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.facemime
        column = layout.column(align=True)
        column.prop(settings, "strength_upper", text="Strength Upper")
        column.prop(settings, "strength_middle", text="Middle")
        column.prop(settings, "strength_lower", text="Lower")
        layout.prop(settings, "mode")
        layout.prop(settings, "kernel")


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(FACEMIME_PT_expression)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(FACEMIME_PT_expression)
