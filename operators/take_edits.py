"""Operators that edit the selected take. Each writes a new file, so that it can be undone."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ..blender.animation.bake import seconds_of
from ..blender.media.images import keep_picture
from ..core.errors import FacemimeError
from ..core.takes.figure import draw_before_after
from ..core.takes.mending import Mending, mend, renew_neutral
from ..core.takes.take import Take
from ..core.takes.timing import punch_in, restart, shift_time, trim
from ..settings import takes_store
from .shared import report
from .takes import OnTake

BLEND = FloatProperty(
    name="Blend", description="Duration of the transition at each end", subtype="TIME_ABSOLUTE", default=0.2, min=0.0
)
"""Property of the operators that insert a range into a take."""


class ChangesTake(OnTake):
    """Mixin: shows a dialog, and replaces the selected take by the result of `changed`."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show the dialog."""
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context: bpy.types.Context) -> None:
        line = takes_store.chosen(context.scene)
        takes_store.change(line, self.changed(context, takes_store.read(line)))


class FACEMIME_OT_trim_take(ChangesTake, bpy.types.Operator):
    """Trim the selected take to a range, and move it to the first frame of the scene"""

    bl_idname = "facemime.trim_take"
    bl_label = "Trim Take"

    start: FloatProperty(name="Start", subtype="TIME_ABSOLUTE", min=0.0)
    end: FloatProperty(name="End", subtype="TIME_ABSOLUTE", min=0.0)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show the dialog; by default the whole take is kept."""
        self.end = takes_store.chosen(context.scene).length
        return super().invoke(context, event)

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return `take`, trimmed."""
        first = float(take.times[0])
        return restart(trim(take, first + self.start, first + self.end))


class FACEMIME_OT_mend_take(ChangesTake, bpy.types.Operator):
    """Mend the selected take: remove outliers, fill gaps without a face, smooth without delay, swap left and right"""

    bl_idname = "facemime.mend_take"
    bl_label = "Mend Take"

    outliers: BoolProperty(
        name="Remove Outliers", description="Remove frames that jump away from their neighbours", default=True
    )
    gaps: EnumProperty(
        name="Gaps",
        description="What to do with gaps of less than a second without a face",
        items=(
            ("leave", "Leave", "Leave gaps as they are"),
            ("bridge", "Interpolate", "Interpolate between the frames on both sides"),
            ("hold", "Hold", "Repeat the last frame with a face"),
        ),
        default="bridge",
    )
    smooth: BoolProperty(name="Smooth", description="Smooth the motion without delay", default=True)
    mirror: BoolProperty(name="Mirror", description="Swap left and right")
    picture: BoolProperty(
        name="Draw Curves", description="Draw the curves before and after as an image for the Image Editor"
    )

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return `take`, mended."""
        smoothing = "zero-phase" if self.smooth else "none"
        mended = mend(take, Mending(self.outliers, self.gaps, smoothing=smoothing, mirror=self.mirror))
        if self.picture:
            image = keep_picture(f"{takes_store.chosen(context.scene).name} Mended", draw_before_after(take, mended))
            report(self, f"Curves drawn in the image {image.name}")
        return mended


class FACEMIME_OT_renew_neutral(OnTake, bpy.types.Operator):
    """Use the face at the current frame as the neutral face of the selected take"""

    bl_idname = "facemime.renew_neutral"
    bl_label = "Set Neutral at Frame"

    def work(self, context: bpy.types.Context) -> None:
        line = takes_store.chosen(context.scene)
        takes_store.change(line, renew_neutral(takes_store.read(line), seconds_of(context.scene)))


class FACEMIME_OT_punch_in_take(ChangesTake, bpy.types.Operator):
    """Insert another take into the selected one, blended at both ends"""

    bl_idname = "facemime.punch_in_take"
    bl_label = "Insert Take"

    other: StringProperty(name="Take", description="Take to insert")
    start: FloatProperty(name="Start", description="Time at which it is inserted", subtype="TIME_ABSOLUTE", min=0.0)
    blend: BLEND

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show the dialog; by default the take is inserted at the current frame."""
        self.start = max(0.0, seconds_of(context.scene))
        return super().invoke(context, event)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the dialog."""
        self.layout.use_property_split = True
        self.layout.prop_search(self, "other", context.scene.facemime_takes, "items")
        self.layout.prop(self, "start")
        self.layout.prop(self, "blend")

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return `take` with the other one inserted."""
        line = context.scene.facemime_takes.items.get(self.other)
        if line is None:
            raise FacemimeError("This take is not in the list. Select the take to insert.")
        insert = takes_store.read(line)
        insert = shift_time(insert, self.start + float(take.times[0]) - float(insert.times[0]))
        return punch_in(take, insert, float(insert.times[0]), float(insert.times[-1]), self.blend)


CLASSES = (FACEMIME_OT_trim_take, FACEMIME_OT_mend_take, FACEMIME_OT_renew_neutral, FACEMIME_OT_punch_in_take)
