"""Paint the three regions, mirror them, smooth their borders."""

import bpy
from bpy.props import EnumProperty, IntProperty

from ..blender.heads.painting import mirror_painted, paint_region, smooth_painted
from .shared import OnHead, ReportsErrors


class FACEMIME_OT_paint_region(OnHead, bpy.types.Operator):
    """Paint the weights of a region on the active head"""

    bl_idname = "facemime.paint_region"
    bl_label = "Paint Region"
    bl_options = {"REGISTER", "UNDO"}

    region: EnumProperty(
        name="Region",
        items=(
            ("UPPER", "Upper", "Brows and upper lids"),
            ("MIDDLE", "Middle", "Lower lids, cheeks, nose and upper lip"),
            ("LOWER", "Lower", "Lower lip, chin and jaw"),
        ),
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        paint_region(context, context.active_object, ("UPPER", "MIDDLE", "LOWER").index(self.region))
        return {"FINISHED"}


class FACEMIME_OT_leave_painting(ReportsErrors, bpy.types.Operator):
    """Go back to Object mode"""

    bl_idname = "facemime.leave_painting"
    bl_label = "Done Painting"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while weights are painted."""
        if context.mode != "PAINT_WEIGHT":
            cls.poll_message_set("No weights are being painted")
            return False
        return True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Switch the mode."""
        bpy.ops.object.mode_set(mode="OBJECT")
        return {"FINISHED"}


class FACEMIME_OT_mirror_regions(OnHead, bpy.types.Operator):
    """Give one half of the face the regions of the other half, mirrored"""

    bl_idname = "facemime.mirror_regions"
    bl_label = "Mirror Regions"
    bl_options = {"REGISTER", "UNDO"}

    source: EnumProperty(
        name="From",
        description="The half that stays as it is; left and right are the head's own",
        items=(("left", "Left to Right", ""), ("right", "Right to Left", "")),
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        mirror_painted(context.active_object, self.source)
        return {"FINISHED"}


class FACEMIME_OT_smooth_regions(OnHead, bpy.types.Operator):
    """Soften the borders of the regions; lips and lids stay apart"""

    bl_idname = "facemime.smooth_regions"
    bl_label = "Smooth Borders"
    bl_options = {"REGISTER", "UNDO"}

    repeat: IntProperty(name="Repeat", default=3, min=1, max=50)

    def work(self, context: bpy.types.Context) -> set[str]:
        smooth_painted(context.active_object, self.repeat)
        return {"FINISHED"}


CLASSES = (
    FACEMIME_OT_paint_region,
    FACEMIME_OT_leave_painting,
    FACEMIME_OT_mirror_regions,
    FACEMIME_OT_smooth_regions,
)
