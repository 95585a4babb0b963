"""Panel Regions: painting, mirroring, smoothing and checking the regions of the face."""

import bpy

from ..blender.names import REGION_GROUPS
from ..operators.shared import subject
from .sidebar import OnHead, draw_findings, place, side_by_side

_BUTTONS = (("UPPER", "Upper"), ("MIDDLE", "Middle"), ("LOWER", "Lower"))


class FACEMIME_PT_regions(OnHead, bpy.types.Panel):
    """Buttons that edit the regions, and the findings of the last check."""

    bl_label = "Regions"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, obj, steps = self.layout, subject(context), context.scene.facemime_steps
        row = side_by_side(layout, context)
        active = obj.vertex_groups.active if obj is not None and context.mode == "PAINT_WEIGHT" else None
        for (region, text), name in zip(_BUTTONS, REGION_GROUPS, strict=True):
            depress = active is not None and active.name == name
            row.operator("facemime.paint_region", text=text, depress=depress).region = region
        if context.mode == "PAINT_WEIGHT":
            layout.operator("facemime.leave_painting", icon="LOOP_BACK")
        row = side_by_side(layout, context)
        row.prop(steps, "show_regions", icon="HIDE_OFF" if steps.show_regions else "HIDE_ON")
        opacity = row.row(align=True)
        opacity.active = steps.show_regions
        opacity.prop(steps, "regions_opacity", text="")
        column = layout.column(align=True)
        row = side_by_side(column, context)
        row.operator("facemime.mirror_regions", text="Left to Right", icon="MOD_MIRROR").source = "left"
        row.operator("facemime.mirror_regions", text="Right to Left").source = "right"
        row = side_by_side(column, context)
        row.operator("facemime.smooth_regions", icon="MOD_SMOOTH").repeat = steps.smooth_repeat
        row.prop(steps, "smooth_repeat", text="")
        column.operator("facemime.propose_regions", icon="GROUP_VERTEX")
        column.operator("facemime.check_head", icon="CHECKMARK")
        draw_findings(layout, context)


CLASSES = (FACEMIME_PT_regions,)
