"""Operator that re-records a range of the selected take."""

import bpy
from bpy.props import FloatProperty, IntProperty

from ..blender.stubs import OperatorResult
from ..blender.timeline import seconds_at
from ..settings import takes_store
from ..settings.values import take_start
from .puppet import require_puppet, required_puppet
from .shared import require
from .take_edits import BLEND_PROPERTY
from .takes import OnTake


class FACEMIME_OT_rerecord_take(OnTake, bpy.types.Operator):
    """Re-record the selected take between two frames with pre-roll, blended at both ends"""

    bl_idname = "facemime.rerecord_take"
    bl_label = "Re-Record Range"
    bl_options = {"REGISTER"}

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
    blend: BLEND_PROPERTY

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet and a take, and that no range is being re-recorded."""
        return (
            require_puppet(cls)
            and require(cls, required_puppet().recorder.punch_in is None, "A range is already being re-recorded")
            and super().poll(context)
        )

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


CLASSES = (FACEMIME_OT_rerecord_take,)
