"""Operator that tracks a whole video and bakes it."""

import bpy
from bpy.app.translations import pgettext_rpt as _
from bpy.props import StringProperty

from ..blender.animation.puppet import check_heads, puppet_heads
from ..blender.meshes import object_of
from ..blender.stubs import OperatorResult
from ..blender.viewports import redraw
from ..core.errors import FacemimeError, Message
from ..core.files.suffixes import VIDEO_SUFFIXES, shown_files
from ..core.takes.file import SUFFIX, load_take
from ..core.takes.take import Take
from ..sessions.tracking import TrackingSession
from ..settings import takes_store
from ..settings.values import face_of, placing_of, pose_targets, puppet_settings
from .shared import AsksForFile, heads_in, report, reporting_range, require_heads, require_object_mode
from .steps import ShowsProgress

_TICK = 0.1


class FACEMIME_OT_puppet_video(ShowsProgress, AsksForFile, bpy.types.Operator):
    """Track the face in a video, keep it as a take, and bake it to the active head and all other selected heads"""

    bl_idname = "facemime.puppet_video"
    bl_label = "Puppet from Video"
    needs = (require_object_mode, require_heads)

    filepath: StringProperty(name="Video", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default=shown_files(*sorted(VIDEO_SUFFIXES), SUFFIX), options={"HIDDEN"})

    _session: TrackingSession | None = None
    _head: str = ""
    _announced = False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for a file, unless the button provides one."""
        return self.execute(context) if self.filepath else super().invoke(context, event)

    def work(self, context: bpy.types.Context) -> OperatorResult:
        """Track in the background, then bake; without a window, wait for the tracking."""
        path, heads = self.path, list(heads_in(context))
        scene = context.scene.facemime
        settings = puppet_settings(scene)
        check_heads(heads, settings.bake, pose_targets(scene.posing, heads[0]))
        if path.suffix == SUFFIX:
            return self.bake(context, heads[0], load_take(path))
        self._session = TrackingSession(path, face_of(scene.source), settings.tracking)
        self._head = heads[0].name
        if bpy.app.background:
            return self.finish(context)
        return self.start_ticking(context, _TICK)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Show the progress; Esc stops tracking and bakes the frames so far."""
        if event.type == "ESC":
            self._tracked.stop()
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._tracked.tracking:
            done, total = self._tracked.done, self._tracked.total
            context.window_manager.progress_update(done / max(total, 1))
            progress = _("Facemime: {done} of {total} frames tracked; Esc to stop and bake them")
            context.workspace.status_text_set(progress.format(done=done, total=total))
            redraw(context, "UI")
            return {"PASS_THROUGH"}
        if not self._announced:  # the window is drawn once more before it waits for the bake
            self._announced = True
            context.workspace.status_text_set(_("Facemime: baking {total} frames").format(total=self._tracked.done))
            return {"PASS_THROUGH"}
        return self.reporting(self.finish, context)

    def finish(self, context: bpy.types.Context) -> OperatorResult:
        """Keep the tracked take in the list, and bake it.

        Raises FacemimeError if nothing was tracked, or the take cannot be baked.
        """
        try:
            take = self._tracked.take()
            name = self._keep(context, take) if take.found.any() else ""
            try:
                return self.bake(context, context.scene.objects.get(self._head), take)
            except FacemimeError as error:
                if not name:
                    raise
                raise type(error)(
                    Message("{error} The tracked take is in the list as {name}.", error=error, name=name)
                ) from error
        finally:
            self.cancel(context)

    @property
    def _tracked(self) -> TrackingSession:
        """The session until it ends."""
        assert self._session is not None
        return self._session

    def _keep(self, context: bpy.types.Context, take: Take) -> str:
        """Add the take to the list; return its name, or "" if it cannot be written: it can be baked anyway."""
        try:
            return takes_store.keep(context.scene, take, self._tracked.video.stem, str(self._tracked.video)).name
        except FacemimeError as error:
            report(self, str(error), "WARNING")
            return ""

    def bake(self, context: bpy.types.Context, head: bpy.types.Object | None, take: Take) -> OperatorResult:
        """Bake `take` to `head` and to all other selected heads, and report the result."""
        settings, head = context.scene.facemime, object_of(head)
        targets = pose_targets(settings.posing, head)
        with reporting_range(self, context.scene):
            driven = puppet_settings(settings, placing_of(context.scene))
            bake, *_ = puppet_heads(context.scene, _heads(context, head), take, driven, targets)
        lost = len(take) - int(take.found.sum())
        frames, summary = len(take), bake.summary()
        report(self, "{frames} frames ({lost} without a face), {summary}", frames=frames, lost=lost, summary=summary)
        lacks = take.info.get("recovered")
        for warning in (*([str(lacks)] if lacks else []), *bake.warnings):
            report(self, warning, "WARNING")
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """End the session and the timer; may be called twice."""
        redraw(context, "UI")
        if self._session is not None:
            self._session.close()
        self._session = None
        self.stop_ticking(context)


def _heads(context: bpy.types.Context, first: bpy.types.Object) -> list[bpy.types.Object]:
    """Return `first` and all other heads that are selected now."""
    others = [head for head in heads_in(context) if head != first] if context.selected_objects else []
    return [first, *others]


class FACEMIME_OT_stop_tracking(bpy.types.Operator):
    """Stop tracking, keep the frames tracked so far as a take, and bake them"""

    bl_idname = "facemime.stop_tracking"
    bl_label = "Stop Tracking"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require that a video is being tracked."""
        return TrackingSession.running() is not None

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Ask the session to stop; its operator bakes."""
        session = TrackingSession.running()
        if session is not None:
            session.stop()
        return {"FINISHED"}
