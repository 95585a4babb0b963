"""Change the chosen take: trim, mend, punch another one in. The file before stays, and an undo goes back to it."""

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
from .takes import OnTake


class ChangesTake(OnTake):
    """Mixin: asks, and lets the chosen take be what `changed` gives."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask."""
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context: bpy.types.Context) -> set[str]:
        line = takes_store.chosen(context.scene)
        takes_store.change(line, self.changed(context, takes_store.read(line)))
        return {"FINISHED"}


class FACEMIME_OT_trim_take(ChangesTake, bpy.types.Operator):
    """Keep the seconds from start to end of the chosen take; it begins at the scene's first frame then"""

    bl_idname = "facemime.trim_take"
    bl_label = "Trim Take"
    bl_options = {"REGISTER", "UNDO"}

    start: FloatProperty(name="Start", subtype="TIME_ABSOLUTE", min=0.0)
    end: FloatProperty(name="End", subtype="TIME_ABSOLUTE", min=0.0)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask, with the whole take as what is kept."""
        self.end = takes_store.chosen(context.scene).length
        return super().invoke(context, event)

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """The part of `take`."""
        first = float(take.times[0])
        return restart(trim(take, first + self.start, first + self.end))


class FACEMIME_OT_mend_take(ChangesTake, bpy.types.Operator):
    """Mend the chosen take: drop frames that jump, fill gaps without a face, smooth without delay, swap the sides"""

    bl_idname = "facemime.mend_take"
    bl_label = "Mend Take"
    bl_options = {"REGISTER", "UNDO"}

    outliers: BoolProperty(name="Drop Outliers", description="Frames that jump out of line", default=True)
    gaps: EnumProperty(
        name="Gaps",
        description="What is done where no face was found for less than a second",
        items=(
            ("leave", "Leave", "Nothing"),
            ("bridge", "Bridge", "Move evenly from the last face to the next"),
            ("hold", "Hold", "Stay as the last face was"),
        ),
        default="bridge",
    )
    smooth: BoolProperty(name="Smooth", description="Without any delay", default=True)
    mirror: BoolProperty(name="Mirror", description="Swap left and right")
    picture: BoolProperty(name="Draw Curves", description="Before and after, as an image of the Image Editor")

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """`take`, mended as asked."""
        smoothing = "zero-phase" if self.smooth else "none"
        mended = mend(take, Mending(self.outliers, self.gaps, smoothing=smoothing, mirror=self.mirror))
        if self.picture:
            image = keep_picture(f"{takes_store.chosen(context.scene).name} Mended", draw_before_after(take, mended))
            self.report({"INFO"}, f"Curves in the image {image.name}")
        return mended


class FACEMIME_OT_renew_neutral(OnTake, bpy.types.Operator):
    """Let the face of the chosen take at the scene's frame be its neutral one"""

    bl_idname = "facemime.renew_neutral"
    bl_label = "Neutral Here"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        line = takes_store.chosen(context.scene)
        takes_store.change(line, renew_neutral(takes_store.read(line), seconds_of(context.scene)))
        return {"FINISHED"}


class FACEMIME_OT_punch_in_take(ChangesTake, bpy.types.Operator):
    """Put another take into the chosen one from a moment on, blended at both ends"""

    bl_idname = "facemime.punch_in_take"
    bl_label = "Punch In"
    bl_options = {"REGISTER", "UNDO"}

    other: StringProperty(name="Take", description="The take that is put in, whole")
    start: FloatProperty(name="At", description="Where it begins", subtype="TIME_ABSOLUTE", min=0.0)
    blend: FloatProperty(
        name="Blend", description="How long one passes into the other", subtype="TIME_ABSOLUTE", default=0.2, min=0.0
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask, with the scene's frame as the moment."""
        self.start = max(0.0, seconds_of(context.scene))
        return super().invoke(context, event)

    def draw(self, context: bpy.types.Context) -> None:
        """The takes to choose from, and the rest."""
        self.layout.use_property_split = True
        self.layout.prop_search(self, "other", context.scene.facemime_takes, "items")
        self.layout.prop(self, "start")
        self.layout.prop(self, "blend")

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """`take` with the other one in it."""
        line = context.scene.facemime_takes.items.get(self.other)
        if line is None:
            raise FacemimeError("There is no such take in the list. Choose the one to put in.")
        insert = takes_store.read(line)
        insert = shift_time(insert, self.start + float(take.times[0]) - float(insert.times[0]))
        return punch_in(take, insert, float(insert.times[0]), float(insert.times[-1]), self.blend)


CLASSES = (FACEMIME_OT_trim_take, FACEMIME_OT_mend_take, FACEMIME_OT_renew_neutral, FACEMIME_OT_punch_in_take)
