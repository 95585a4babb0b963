"""Record a part of the chosen take anew."""

import bpy
from bpy.props import FloatProperty, IntProperty

from ..blender.animation.bake import seconds_at
from ..blender.registering import watch
from ..blender.undo import push_undo
from ..core.errors import FacemimeError
from ..sessions.punch_in import PunchIn
from ..settings import takes_store
from .puppet import running
from .takes import OnTake

_WATCH = 0.02


class FACEMIME_OT_rerecord_take(OnTake, bpy.types.Operator):
    """Record the chosen take anew between two frames, after a lead that is played, blended in at both ends"""

    bl_idname = "facemime.rerecord_take"
    bl_label = "Record Between"
    bl_options = {"REGISTER"}

    start: IntProperty(name="From", description="Frame at which the new part begins", default=1)
    end: IntProperty(name="To", description="Frame at which it ends", default=50)
    lead: FloatProperty(
        name="Lead", description="How long is played before", subtype="TIME_ABSOLUTE", default=2.0, min=0.0, max=30.0
    )
    blend: FloatProperty(
        name="Blend", description="How long one passes into the other", subtype="TIME_ABSOLUTE", default=0.2, min=0.0
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while the puppet runs and nothing is recorded."""
        if running() is None:
            cls.poll_message_set("Start the puppet first: step Puppet, above")
            return False
        if PunchIn.current is not None:
            cls.poll_message_set("It is running already. Stop it first")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask, with the preview range, or the two seconds from the current frame."""
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
        _Played.begin(context, self.start - round(self.lead * scene.render.fps / scene.render.fps_base))
        watch(_watch, _WATCH)
        return {"FINISHED"}


class _Played:
    """The scene that is played along, by the clock, and how it was played before."""

    scene = ""
    sync_mode = ""

    @classmethod
    def begin(cls, context: bpy.types.Context, frame: int) -> None:
        scene = context.scene
        cls.scene, cls.sync_mode = scene.name, scene.sync_mode
        scene.sync_mode = "AUDIO_SYNC"
        scene.frame_set(frame)
        if context.screen is not None and not context.screen.is_animation_playing:
            bpy.ops.screen.animation_play()

    @classmethod
    def end(cls) -> None:
        if (scene := bpy.data.scenes.get(cls.scene)) is not None:
            scene.sync_mode = cls.sync_mode
        for window in bpy.context.window_manager.windows:
            if window.screen.is_animation_playing:
                with bpy.context.temp_override(window=window):
                    bpy.ops.screen.animation_cancel(restore_frame=False)


def _watch() -> float | None:
    """Go on with the part; at its end, one undo step."""
    if PunchIn.current is None:
        return None
    try:
        if PunchIn.current.step():
            return _WATCH
    except FacemimeError as error:
        _Played.end()
        _tell(str(error))
        return None
    _Played.end()
    push_undo("Record Between")
    return None


def _tell(message: str) -> None:
    """Show an error that no operator is there to report."""

    def draw(self: bpy.types.Menu, context: bpy.types.Context) -> None:
        self.layout.label(text=message, translate=False)

    if bpy.app.background:
        print(f"facemime: {message}")
    else:
        bpy.context.window_manager.popup_menu(draw, title="Facemime", icon="ERROR")


CLASSES = (FACEMIME_OT_rerecord_take,)
TIMERS = (_watch,)


def unregister() -> None:
    """Unregister it; a part that is being recorded is left."""
    PunchIn.current = None
