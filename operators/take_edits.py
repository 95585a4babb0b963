"""Operators that edit the selected take, or record a range of it again.

Each writes a new file; the previous one is kept.
"""

import math

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty, IntProperty, StringProperty

from ..blender.stubs import OperatorResult
from ..blender.timeline import frame_range, seconds_at, seconds_of
from ..core.errors import FacemimeError
from ..core.takes.mending import REPAIR, Mending, mend, renew_neutral
from ..core.takes.table_times import timecode
from ..core.takes.take import Take
from ..core.takes.timing import BLEND, punch_in, restart, shift_time, trim
from ..settings import takes_store
from ..settings.rna import read, with_settings
from ..settings.values import take_start
from .puppet import require_puppet, required_puppet
from .shared import require
from .takes import OnTake, require_take

_BLEND_PROPERTY = FloatProperty(
    name="Blend", description="Duration of the transition at each end", subtype="TIME_ABSOLUTE", default=BLEND, min=0.0
)
"""Property of the operators that insert a range into a take."""


class _AddsEditedTake(OnTake):
    """Mixin: shows a dialog, and adds the result of `changed` below the selected take, which is kept.

    `suffix` is appended to the name of the selected take.
    """

    suffix = ""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Show the dialog."""
        return self.reporting(self.ask, context)

    def ask(self, context: bpy.types.Context) -> OperatorResult:
        """Show the dialog; raises FacemimeError."""
        return context.window_manager.invoke_props_dialog(self)

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return the edited take."""
        raise NotImplementedError

    def work(self, context: bpy.types.Context) -> None:
        line = takes_store.chosen(context.scene)
        edited = self.changed(context, takes_store.read(line, solved=False))
        takes_store.keep_beside(context.scene, edited, f"{line.name}_{self.suffix}")


def _at_frame(take: Take, seconds: float) -> float:
    """Return the time of a frame of `take` if `seconds`, which Blender's properties round, is meant to be that."""
    nearest = float(take.times[np.abs(take.times - seconds).argmin()])
    return nearest if math.isclose(nearest, seconds, rel_tol=1e-7) else seconds


class FACEMIME_OT_trim_take(_AddsEditedTake, bpy.types.Operator):
    """Add a copy of the selected take that is trimmed to a range, and starts at the first frame"""

    bl_idname = "facemime.trim_take"
    bl_label = "Trim Take"
    suffix = "Trimmed"

    keep: EnumProperty(
        name="Keep",
        description="Part of the take to keep",
        items=(
            ("SECONDS", "Start to End", "The times below"),
            ("TIMELINE", "Timeline Range", "The preview range if it is in use, otherwise the scene's frame range"),
            ("FROM", "From Playhead", "From the current frame to the end"),
            ("TO", "To Playhead", "From the start to the current frame"),
        ),
    )
    start: FloatProperty(name="Start (s)", description="Start of the part to keep, in seconds")
    end: FloatProperty(name="End (s)", description="End of the part to keep, in seconds")
    first: FloatProperty(options={"HIDDEN"})
    last: FloatProperty(options={"HIDDEN"})

    def ask(self, context: bpy.types.Context) -> OperatorResult:
        """Show the dialog, set to the preview range if one is used, otherwise to the whole take."""
        times = takes_store.read(takes_store.chosen(context.scene), solved=False).times
        self.start, self.end = self.first, self.last = times[0], times[-1]
        self.keep = "TIMELINE" if context.scene.use_preview_range else "SECONDS"
        return super().ask(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the dialog, with the kept range in minutes and seconds."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "keep")
        column = layout.column(align=True)
        column.enabled = self.keep == "SECONDS"
        column.prop(self, "start")
        column.prop(self, "end")
        start, end = (min(max(seconds, self.first), self.last) for seconds in self.kept(context.scene))
        text = f"{timecode(start)} - {timecode(end)}   ({timecode(max(end - start, 0.0))})"
        layout.label(text=text, translate=False, icon="TIME")

    def kept(self, scene: bpy.types.Scene) -> tuple[float, float]:
        """Return the range that is kept, seconds in the take's own time; it may extend beyond its ends."""
        start = take_start(scene)
        if self.keep == "TIMELINE":
            frames = frame_range(scene)
            return seconds_at(scene, frames.start, start), seconds_at(scene, frames.stop - 1, start)
        if self.keep == "FROM":
            return seconds_of(scene, start), math.inf
        if self.keep == "TO":
            return -math.inf, seconds_of(scene, start)
        return self.start, self.end

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return `take`, trimmed."""
        start, end = (_at_frame(take, seconds) for seconds in self.kept(context.scene))
        return restart(trim(take, start, end))


@with_settings(REPAIR)
class FACEMIME_OT_mend_take(_AddsEditedTake, bpy.types.Operator):
    """Add a mended copy of the selected take: without outliers and gaps, smoothed without delay, or mirrored"""

    bl_idname = "facemime.mend_take"
    bl_label = "Mend Take"
    suffix = "Mended"

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return `take`, mended."""
        return mend(take, read(Mending, self))


class FACEMIME_OT_renew_neutral(OnTake, bpy.types.Operator):
    """Use the face at the current frame as the neutral face of the selected take"""

    bl_idname = "facemime.renew_neutral"
    bl_label = "Set Neutral at Frame"

    def work(self, context: bpy.types.Context) -> None:
        line, scene = takes_store.chosen(context.scene), context.scene
        takes_store.change(
            line, renew_neutral(takes_store.read(line, solved=False), seconds_of(scene, take_start(scene)))
        )


class FACEMIME_OT_punch_in_take(_AddsEditedTake, bpy.types.Operator):
    """Add a copy of the selected take with another take inserted, blended at both ends"""

    bl_idname = "facemime.punch_in_take"
    bl_label = "Insert Take"
    suffix = "Edited"

    other: StringProperty(name="Take", description="Take to insert")
    start: FloatProperty(name="Start (s)", description="Time at which it is inserted, in seconds")
    blend: _BLEND_PROPERTY

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a selected take and another one."""
        several = len(context.scene.facemime_takes.items) > 1
        return super().poll(context) and require(cls, several, "Record or import another take first")

    def ask(self, context: bpy.types.Context) -> OperatorResult:
        """Show the dialog; by default the newest other take is inserted at the current frame."""
        selected = takes_store.chosen(context.scene)
        self.other = [line.name for line in context.scene.facemime_takes.items if line != selected][-1]
        first = float(takes_store.read(selected, solved=False).times[0])
        self.start = max(first, seconds_of(context.scene, take_start(context.scene)))
        return super().ask(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the dialog."""
        self.layout.use_property_split = True
        self.layout.prop_search(self, "other", context.scene.facemime_takes, "items")
        self.layout.prop(self, "start")
        self.layout.prop(self, "blend")

    def changed(self, context: bpy.types.Context, take: Take) -> Take:
        """Return `take` with the other one inserted."""
        # Several takes may have the same name: like the dialog's default, the newest that is not the selected one.
        selected = takes_store.chosen(context.scene)
        named = [line for line in context.scene.facemime_takes.items if line.name == self.other]
        others = [line for line in named if line != selected]
        if named and not others:
            raise FacemimeError("A take cannot be inserted into itself. Select another take to insert.")
        if not others:
            raise FacemimeError("This take is not in the list. Select the take to insert.")
        insert = takes_store.read(others[-1], solved=False)
        insert = shift_time(insert, _at_frame(take, self.start) - float(insert.times[0]))
        return punch_in(take, insert, float(insert.times[0]), float(insert.times[-1]), self.blend)


def _require_no_range(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    free = required_puppet().recorder.punch_in is None
    return require(operator, free, "A range is already being re-recorded")


class FACEMIME_OT_rerecord_take(OnTake, bpy.types.Operator):
    """Re-record the selected take between two frames with pre-roll, blended at both ends"""

    bl_idname = "facemime.rerecord_take"
    bl_label = "Re-Record Range"
    bl_options = {"REGISTER"}
    needs = (require_puppet, _require_no_range, require_take)

    start: IntProperty(name="Start", description="First frame of the range", default=1)
    end: IntProperty(name="End", description="Last frame of the range", default=50)
    lead: FloatProperty(
        name="Pre-Roll",
        description="Time played before the range",
        subtype="TIME_ABSOLUTE",
        default=2.0,
        min=0.0,
        max=30.0,
    )
    blend: _BLEND_PROPERTY

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the range; by default the preview range, or two seconds from the current frame."""
        scene = context.scene
        self.start, self.end = scene.frame_current, scene.frame_current + round(2 * scene.render.fps)
        if scene.use_preview_range:
            self.start, self.end = scene.frame_preview_start, scene.frame_preview_end
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        start, end = (seconds_at(scene, frame, take_start(scene)) for frame in (self.start, self.end))
        required_puppet().recorder.rerecord(
            scene, takes_store.chosen(scene).path, start, end, lead=self.lead, blend=self.blend
        )
