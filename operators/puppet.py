"""Operators that puppet heads live from a camera, a video, images or a take."""

import bpy
from bpy.props import StringProperty

from ..blender.animation.live import LiveHeadObject
from ..blender.contexts import find_scene
from ..blender.heads.face_display import FaceDisplay
from ..blender.messages import CONTEXT
from ..blender.stubs import OperatorResult
from ..blender.viewports import redraw, viewport_under
from ..core.errors import FacemimeError
from ..sessions.live import TICK, LiveSession
from ..sessions.start import RigWatch, follow_settings, start_session
from ..settings.panel_properties import keep_problem
from ..settings.preferences import preferences
from .preview_place import PreviewDrag
from .shared import ReportsErrors, heads_in, report, require, require_heads, require_left_edit_mode, require_no_session

_STATUS_INTERVAL = 0.25


class FACEMIME_OT_choose_camera(bpy.types.Operator):
    """Use this camera and save it in the preferences"""

    bl_idname = "facemime.choose_camera"
    bl_label = "Choose Camera"
    bl_options = {"INTERNAL"}

    camera: StringProperty(name="Camera")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Store the camera in the preferences."""
        preferences().camera = self.camera
        context.preferences.is_dirty = True
        return {"FINISHED"}


def running() -> LiveSession | None:
    """Return the running live session, or None."""
    return LiveSession.running()


def required_puppet() -> LiveSession:
    """Return the running live session, which `poll` requires."""
    session = running()
    assert session is not None, "no puppet is running"
    return session


def require_puppet(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return for `poll` whether a puppet is running; otherwise set the poll message of `operator`."""
    return require(operator, running() is not None, "Start the puppet first")


def start_puppet() -> None:
    """Start the puppet from another operator; raises FacemimeError if it cannot be started."""
    try:
        bpy.ops.facemime.puppet("INVOKE_DEFAULT")  # type: ignore[attr-defined]  # registered at run time
    except RuntimeError as error:
        raise FacemimeError(str(error).strip().removeprefix("Error: ")) from error


class FACEMIME_OT_puppet(ReportsErrors, bpy.types.Operator):
    """Drive the active head and all other selected heads with the face in the source; Esc in the viewport stops it"""

    bl_idname = "facemime.puppet"
    bl_label = "Start Puppet"
    bl_options = {"REGISTER"}
    needs = (require_no_session, require_left_edit_mode, require_heads)

    _session: LiveSession
    _rigs: RigWatch
    _timer: bpy.types.Timer | None = None
    _scene = 0
    _clicked = False
    _drag: PreviewDrag
    _display: FaceDisplay
    _redrawn_at = 0.0
    _text = ""
    _heads: tuple[LiveHeadObject, ...] = ()

    def work(self, context: bpy.types.Context) -> OperatorResult:
        """Start the session, and continue at every tick of a timer."""
        heads = heads_in(context)
        try:
            self._session = start_session(context.scene, heads)
        except FacemimeError as error:
            keep_problem(context, str(error))
            raise
        keep_problem(context, "")
        for warning in self._session.overruled():
            report(self, warning, "WARNING")
        self._display = FaceDisplay(heads, bones=_hides_bones(context))
        self._rigs = RigWatch(self._session)
        self._scene, self._drag = context.scene.session_uid, PreviewDrag()
        self._session.operator = self
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK, window=context.window)
        manager.modal_handler_add(self)
        context.workspace.status_text_set(_draw_hints)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Handle a tick or the end; pass other events through."""
        if self._session.closed:
            return self.finish(context)
        if (
            event.type == "ESC"
            and event.value == "PRESS"
            and viewport_under(context, event.mouse_x, event.mouse_y) is not None
        ):
            return {"RUNNING_MODAL"} if self._session.recorder.cancel_countdown() else self.finish(context)
        if self._drag.handle(context, event):
            return {"RUNNING_MODAL"}
        if event.value in ("PRESS", "CLICK"):
            self._clicked = True
        if event.type == "TIMER":
            return self.reporting(self.tick_or_end, context)
        return {"PASS_THROUGH"}

    def tick_or_end(self, context: bpy.types.Context) -> OperatorResult:
        """Handle a tick; an error ends the session."""
        try:
            return self.tick(context)
        except Exception as error:
            if isinstance(error, FacemimeError):
                keep_problem(context, str(error))
            self.finish(context)
            raise

    def tick(self, context: bpy.types.Context) -> OperatorResult:
        """Show the newest result and follow the settings."""
        session = self._session
        self._display.bones = _hides_bones(context)
        if (scene := find_scene(self._scene)) is not None:
            follow_settings(session, scene)
        if (heads := tuple(session.heads)) != self._heads:  # an undo has replaced them
            self._heads, self._clicked = heads, True
        if self._clicked and not _painting(context):
            self._clicked = False
            self._rigs.look()
        self._rigs.step()
        if session.step():
            redraw(context, "WINDOW")
        if session.pending:
            session.attend()
        if session.ended:
            return self.finish(context)
        if (text := session.stopwatch.text) != self._text:  # the Sidebar and the preview show the same figures
            self._text = text
            redraw(context, "UI")
        if abs(self._timer_seconds() - self._redrawn_at) > _STATUS_INTERVAL:
            self._redrawn_at = self._timer_seconds()
            redraw(context, "UI")
            if session.countdown is not None:  # it continues while no frame arrives
                redraw(context, "WINDOW")
        return {"PASS_THROUGH"}

    def finish(self, context: bpy.types.Context) -> OperatorResult:
        """End the session, and report what went wrong."""
        self._session.close()
        if self._session.warning:
            report(self, self._session.warning, "WARNING")
        redraw(context, "UI")
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """End the session as Blender closes the window; may be called twice."""
        self._session.operator = None
        self.release()
        self._session.close_later()  # pushing an undo step here crashes Blender 4.3

    def release(self) -> None:
        """End the timer; called by the session when it is closed."""
        self._display.close()
        if self._timer is not None:
            bpy.context.window_manager.event_timer_remove(self._timer)
            for workspace in bpy.data.workspaces:
                workspace.status_text_set(None)
        self._timer = None

    def _timer_seconds(self) -> float:
        return float(self._timer.time_duration) if self._timer is not None else 0.0


class FACEMIME_OT_stop_puppet(bpy.types.Operator):
    """Stop the puppet; the heads return to rest, unless Keep Pose is enabled"""

    bl_idname = "facemime.stop_puppet"
    bl_label = "Stop Puppet"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet."""
        return require(cls, running() is not None, "No puppet is running")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Let Esc cancel the countdown of a recording first, as in the window in which the puppet was started."""
        if event.type == "ESC" and required_puppet().recorder.cancel_countdown():
            return {"FINISHED"}
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """End the session; the modal operator ends at the next event."""
        required_puppet().close()
        redraw(context, "UI")
        return {"FINISHED"}


class FACEMIME_OT_next_face(bpy.types.Operator):
    """Track the next face to the right; after the last one, the leftmost"""

    bl_idname = "facemime.next_face"
    bl_label = "Next Face"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet that tracks images."""
        session = running()
        sees = session is not None and session.worker.image_size != (0, 0)
        return require(cls, sees, "Start the puppet with a camera, a video or an image sequence first")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Request the next face, which is tracked from the next frame."""
        required_puppet().worker.follow_next()
        return {"FINISHED"}


def _hides_bones(context: bpy.types.Context) -> bool:
    """Return whether bones are hidden: not while somebody poses them."""
    return bool(context.scene.facemime.hide_bones) and context.mode != "POSE"


def _draw_hints(header: bpy.types.Header, context: bpy.types.Context) -> None:
    """Draw the status bar while a puppet is running: its keys, or those of what has the keyboard, such as Move."""
    layout, session = header.layout, running()
    recording = session is not None and session.recorder.recording is not None
    if _is_busy(context.window):
        layout.template_input_status()
    else:
        row = layout.row()
        row.label(text="Stop Puppet", text_ctxt=CONTEXT, icon="EVENT_ESC")
        for icon in ("EVENT_SHIFT", "EVENT_ALT", "EVENT_R"):
            row.label(text="", icon=icon)
        row.label(text="Stop Recording" if recording else "Record", text_ctxt=CONTEXT)
    if recording:
        layout.label(text="Recording", text_ctxt=CONTEXT, icon="REC")
    layout.separator_spacer()
    layout.template_reports_banner()


def _is_busy(window: bpy.types.Window | None) -> bool:
    """Return whether another operator than the puppet handles the events of a window first."""
    return window is not None and any(
        op is not None and op.bl_idname != FACEMIME_OT_puppet.__name__ for op in window.modal_operators
    )


def _painting(context: bpy.types.Context) -> bool:
    """Return whether a brush stroke is in progress."""
    window = context.window
    return window is not None and any(
        op is not None and op.bl_idname.startswith("PAINT_OT") for op in window.modal_operators
    )  # an operator that has just ended leaves None
