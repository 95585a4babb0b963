"""Panel Expression: strength of the regions, smoothing, skin, and presets."""

import bpy

from ..blender.messages import CONTEXT
from ..core.puppet.built_in_presets import BUILT_IN
from ..settings import user_presets as presets
from .sidebar import Sidebar, labels, place, split_labels


class FACEMIME_MT_presets(bpy.types.Menu):
    """Presets of Facemime, and your own"""

    bl_label = "Presets"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the presets and the operators on them."""
        layout, names = self.layout, presets.names()
        for name, label in BUILT_IN.items():
            button = layout.operator("facemime.load_preset", text=label)
            button.name, button.built_in = name, True
        layout.separator()
        for name in names:
            layout.operator("facemime.load_preset", text=name, translate=False).name = name
        if names:
            layout.separator()
        layout.operator("facemime.save_preset", icon="ADD")
        if names:
            layout.menu("FACEMIME_MT_remove_preset", icon="REMOVE")
        layout.separator()
        layout.operator("facemime.import_preset", icon="IMPORT")
        layout.operator("facemime.export_preset", icon="EXPORT")


class FACEMIME_MT_remove_preset(bpy.types.Menu):
    """Your presets, to remove one"""

    bl_label = "Remove Preset"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the presets."""
        for name in presets.names():
            self.layout.operator("facemime.remove_preset", text=name, translate=False).name = name


class FACEMIME_PT_expression(Sidebar, bpy.types.Panel):
    """Strength of the regions, smoothing, depth and skin."""

    bl_label = "Expression"
    bl_order = place(__name__)
    header_icons = 1

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the menu of presets in the header."""
        Sidebar.draw_header_preset(self, context)
        self.layout.menu("FACEMIME_MT_presets", text="", icon="PRESET")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        split_labels(layout)
        settings = context.scene.facemime
        column = layout.column(align=True)
        column.prop(settings, "strength_upper", text="Brows", text_ctxt=CONTEXT)
        column.prop(settings, "strength_middle", text="Cheeks", text_ctxt=CONTEXT)
        column.prop(settings, "strength_lower", text="Jaw", text_ctxt=CONTEXT)
        layout.prop(settings, "smoothing")
        labels(layout, context, "How the skin moves. Start the puppet or preview a take to see what changes", "INFO")
        layout.prop(settings, "mode")
        layout.prop(settings, "kernel")
        layout.prop(settings, "only_landmarks")


class FACEMIME_PT_fit(Sidebar, bpy.types.Panel):
    """How the skin is fitted to the landmarks."""

    bl_label = "Fit"
    bl_parent_id = "FACEMIME_PT_expression"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        split_labels(layout)
        settings = context.scene.facemime
        labels(layout, context, "For lids, lips and regions that do not meet. The defaults suit most heads", "INFO")
        layout.prop(settings, "borders")
        layout.prop(settings, "exact")
        layout.prop(settings, "incremental")
        row = layout.row()
        row.active = settings.mode != "planar"
        row.prop(settings, "contact")


CLASSES = (FACEMIME_MT_remove_preset, FACEMIME_MT_presets, FACEMIME_PT_expression, FACEMIME_PT_fit)
