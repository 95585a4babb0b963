"""Operator that re-records a range of the selected take."""

import bpy
from bpy.props import FloatProperty, IntProperty

from ..blender.animation.bake import seconds_at
from ..blender.messages import show_error
from ..blender.registering import watch
from ..blender.undo import push_undo
from ..core.errors import FacemimeError
from ..sessions.punch_in import PunchIn
from ..settings import takes_store
from .puppet import running
from .takes import OnTake

_WATCH = 0.02


class FACEMIME_OT_rerecord_take(OnTake, bpy.types.Operator):
    """Re-record the selected take between two frames with pre-roll, blended at both ends"""

    bl_idname = "facemime.rerecord_take"
    bl_label = "Re-Record Range"
    bl_options = {"REGISTER"}

    start: IntProperty(name="Start", description="First frame of the range", default=1)
    end: IntProperty(name="End", description="Last frame of the range", default=50)
    lead: FloatProperty(
        name="Pre-Roll",
        description="Time that is played before the range",
        subtype="TIME_ABSOLUTE",
        default=2.0,
        min=0.0,
        max=30.0,
    )
    blend: FloatProperty(
        name="Blend",
        description="Duration of the transition at each end",
        subtype="TIME_ABSOLUTE",
        default=0.2,
        min=0.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet and a take, and that no range is being re-recorded."""
        if running() is None:
            cls.poll_message_set("Start the puppet first, in the Puppet panel")
            return False
        if PunchIn.current is not None:
            cls.poll_message_set("A range is already being re-recorded")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the range; by default the preview range, or two seconds from the current frame."""
        scene = context.scene
        self.start, self.end = scene.frame_current, scene.frame_current + round(2 * scene.render.fps)
        if scene.use_preview_range:
            self.start, self.end = scene.frame_preview_start, scene.frame_preview_end
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        take = takes_store.chosen(scene)
        start, end = (seconds_at(scene, frame) for frame in (self.start, self.end))
        PunchIn(running(), scene, take.path, start, end, lead=self.lead, blend=self.blend)
        _Playback.start(context, self.start - round(self.lead * scene.render.fps / scene.render.fps_base))
        watch(_watch, _WATCH)
        return {"FINISHED"}


class _Playback:
    """The scene that is played during the recording, and its sync mode before."""

    scene = ""
    sync_mode = ""

    @classmethod
    def start(cls, context: bpy.types.Context, frame: int) -> None:
        scene = context.scene
        cls.scene, cls.sync_mode = scene.name, scene.sync_mode
        scene.sync_mode = "AUDIO_SYNC"
        scene.frame_set(frame)
        if context.screen is not None and not context.screen.is_animation_playing:
            bpy.ops.screen.animation_play()

    @classmethod
    def stop(cls) -> None:
        if (scene := bpy.data.scenes.get(cls.scene)) is not None:
            scene.sync_mode = cls.sync_mode
        for window in bpy.context.window_manager.windows:
            if window.screen.is_animation_playing:
                with bpy.context.temp_override(window=window):
                    bpy.ops.screen.animation_cancel(restore_frame=False)


def _watch() -> float | None:
    """Continue the recording; push an undo step at its end."""
    if PunchIn.current is None:
        return None
    try:
        if PunchIn.current.step():
            return _WATCH
    except FacemimeError as error:
        _Playback.stop()
        show_error(str(error))
        return None
    _Playback.stop()
    push_undo("Re-Record Range")
    return None


CLASSES = (FACEMIME_OT_rerecord_take,)
TIMERS = (_watch,)


def unregister() -> None:
    """Abandon a range that is being recorded."""
    PunchIn.current = None
