"""Operators that paint, mirror and smooth the three regions."""

import bpy
from bpy.props import EnumProperty, IntProperty

from ..blender.heads.painting import mirror_painted, paint_region, smooth_painted
from .shared import OnHead, ReportsErrors, require, required_subject


class FACEMIME_OT_paint_region(OnHead, bpy.types.Operator):
    """Paint the weights of this region on the active head"""

    bl_idname = "facemime.paint_region"
    bl_label = "Paint Region"

    region: EnumProperty(
        name="Region",
        items=(
            ("UPPER", "Upper", "Brows and upper eyelids"),
            ("MIDDLE", "Middle", "Lower eyelids, cheeks, nose and upper lip"),
            ("LOWER", "Lower", "Lower lip, chin and jaw"),
        ),
    )

    def work(self, context: bpy.types.Context) -> None:
        paint_region(context, required_subject(context), ("UPPER", "MIDDLE", "LOWER").index(self.region))


class FACEMIME_OT_leave_painting(ReportsErrors, bpy.types.Operator):
    """Return to Object Mode"""

    bl_idname = "facemime.leave_painting"
    bl_label = "Finish Painting"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require Weight Paint Mode."""
        return require(cls, context.mode == "PAINT_WEIGHT", "Only available in Weight Paint Mode")

    def work(self, context: bpy.types.Context) -> None:
        """Switch to Object Mode."""
        bpy.ops.object.mode_set(mode="OBJECT")


class FACEMIME_OT_mirror_regions(OnHead, bpy.types.Operator):
    """Mirror the regions of one half of the face to the other"""

    bl_idname = "facemime.mirror_regions"
    bl_label = "Mirror Regions"

    source: EnumProperty(
        name="Direction",
        description="Direction in which the regions are copied; left and right are the head's own",
        items=(("left", "Left to Right", ""), ("right", "Right to Left", "")),
    )

    def work(self, context: bpy.types.Context) -> None:
        mirror_painted(required_subject(context), "left" if self.source == "left" else "right")


class FACEMIME_OT_smooth_regions(OnHead, bpy.types.Operator):
    """Smooth the borders of the regions, except between the lips and between the eyelids"""

    bl_idname = "facemime.smooth_regions"
    bl_label = "Smooth Borders"

    repeat: IntProperty(name="Repeat", default=3, min=1, max=50)

    def work(self, context: bpy.types.Context) -> None:
        smooth_painted(required_subject(context), self.repeat)


CLASSES = (
    FACEMIME_OT_paint_region,
    FACEMIME_OT_leave_painting,
    FACEMIME_OT_mirror_regions,
    FACEMIME_OT_smooth_regions,
)
