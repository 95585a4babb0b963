"""Operators that place landmarks and marked points by clicks on the head."""

from collections.abc import Callable
from functools import partial
from typing import ClassVar

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as _
from bpy.props import StringProperty

from ..blender.contexts import evaluated_depsgraph, in_a_window
from ..blender.heads.face_display import FaceDisplay
from ..blender.heads.placing import (
    NEAR,
    FormerBinding,
    Placing,
    landmark_places,
    marks_to_ask,
    nearest_landmark,
    skin_under,
)
from ..blender.stubs import OperatorResult
from ..blender.viewports import Viewport, redraw, viewport_under
from ..core.control_points.select import parse_landmarks
from ..core.errors import HeadError
from ..core.face.landmarks import IBUG68_INDICES
from ..core.heads.bind import MIN_MARKS
from ..sessions.session import Session
from .shared import (
    Need,
    OnHead,
    OnMesh,
    ReportsErrors,
    report,
    require,
    require_mesh,
    require_object_mode,
    required_subject,
    subject,
)

_ENTER = {"RET", "NUMPAD_ENTER"}


def placing_on(obj: bpy.types.Object | None) -> Placing | None:
    """Return the placing of points in progress on `obj`, or None."""
    placing = Placing.current
    return placing if placing is not None and obj is not None and placing.obj == obj else None


class CheckedBinding:
    """The binding before the one that the next placing checks, and whether it is shown alone in Local View."""

    former: FormerBinding | None = None
    alone = False

    @classmethod
    def taking_back(cls, context: bpy.types.Context) -> Callable[[], None] | None:
        """Return a function that takes the new binding back, once; None if the placing checks an older one."""
        former, cls.former = cls.former, None
        return None if former is None else partial(_take_back, former, cls.alone)


def _take_back(former: FormerBinding, alone: bool) -> None:
    context = bpy.context
    former.restore(context)
    space = context.space_data
    if alone and isinstance(space, bpy.types.SpaceView3D) and space.local_view is not None:
        bpy.ops.view3d.localview(frame_selected=False)


class _PlacesPoints(ReportsErrors):
    """Mixin: a modal operator that places points on the active mesh until Enter or Esc; the view can be turned.

    It also ends, and keeps the points, as soon as the mesh is changed or a puppet is started.
    """

    needs: ClassVar[tuple[Need, ...]] = (require_object_mode, require_mesh)
    _placing: Placing
    _display: FaceDisplay
    _showed = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require an active mesh in Object Mode, and that no puppet is running."""
        return super().poll(context) and require(cls, Session.running() is None, "Stop the puppet first")

    def begin(self, obj: bpy.types.Object) -> Placing:
        """Return the placing to start."""
        raise NotImplementedError

    def hint(self) -> str:
        """Return the translated text of the status bar."""
        raise NotImplementedError

    def handle(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Handle an event other than Enter and Esc."""
        raise NotImplementedError

    def work(self, context: bpy.types.Context) -> OperatorResult:
        """Wait for clicks."""
        if bpy.app.background or context.window is None:
            raise HeadError("There is no window to click in. Use Set Landmark or Mark Point in Edit Mode instead.")
        obj = required_subject(context)
        self._placing = Placing.current = self.begin(obj)
        self._display = FaceDisplay([obj], bones=True)
        steps = context.scene.facemime_steps
        self._showed, steps.show_points = steps.show_points, True
        context.workspace.status_text_set(self.hint())
        context.window_manager.modal_handler_add(self)
        redraw(context)
        redraw(context, "UI")
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Handle an event."""
        if not self._goes_on(context):
            self.cancel(context)
            # What has changed the mesh meanwhile is an undo step itself.
            changed = self._placing.changed and self._placing.obj is not None
            return {"FINISHED" if changed else "CANCELLED", "PASS_THROUGH"}
        if event.type == "ESC" and event.value == "PRESS":
            self._placing.discard()
            self.cancel(context)
            return {"FINISHED" if self._placing.changed else "CANCELLED"}
        if event.type in _ENTER and event.value == "PRESS":
            return self.end(context)
        return self.handle(context, event)

    def end(self, context: bpy.types.Context) -> OperatorResult:
        """Keep the placed points, if there are enough."""
        if self._placing.asked and not self._placing.enough:
            report(self, "Mark at least {min_marks} points, or press Esc to cancel", "WARNING", min_marks=MIN_MARKS)
            return {"RUNNING_MODAL"}
        try:
            return self.reporting(lambda _: _keep(self._placing), context)
        finally:
            self.cancel(context)

    def _goes_on(self, context: bpy.types.Context) -> bool:
        placing = self._placing
        there = Placing.current is placing and placing.obj is not None and subject(context) == placing.obj
        return there and context.mode == "OBJECT" and Session.running() is None

    def cancel(self, context: bpy.types.Context) -> None:
        """Restore the status bar and the display of points."""
        if Placing.current is self._placing:
            Placing.current = None
        self._display.close()
        steps = context.scene.facemime_steps
        steps.landmark, steps.show_points = -1, self._showed
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw(context)
        redraw(context, "UI")


def _vertex_under(context: bpy.types.Context, event: bpy.types.Event, seen: Viewport) -> int | None:
    pixel = (event.mouse_x - seen.region.x, event.mouse_y - seen.region.y)
    return skin_under(required_subject(context), evaluated_depsgraph(context), seen, pixel)


class FACEMIME_OT_adjust_landmarks(_PlacesPoints, OnHead, bpy.types.Operator):
    """Drag landmarks to their places on the head; Enter accepts, Esc discards"""

    bl_idname = "facemime.adjust_landmarks"
    bl_label = "Adjust Landmarks"

    def begin(self, obj: bpy.types.Object) -> Placing:
        return Placing(obj, take_back=CheckedBinding.taking_back(bpy.context))

    def hint(self) -> str:
        return _("Drag the points to their places; Enter to accept, Esc to discard")

    def handle(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Highlight the landmark under the mouse; let it follow while the button is held."""
        steps, placing = context.scene.facemime_steps, self._placing
        seen = viewport_under(context, event.mouse_x, event.mouse_y)
        if seen is not None and placing.held >= 0 and event.type in {"MOUSEMOVE", "LEFTMOUSE"}:
            if (vertex := _vertex_under(context, event, seen)) is not None:
                placing.drag(vertex)
                redraw(context)
        elif seen is not None and event.type == "MOUSEMOVE":
            self._hover(context, event, seen)
        elif seen is not None and event.type == "LEFTMOUSE" and event.value == "PRESS":
            placing.held = steps.landmark
        if event.type == "LEFTMOUSE" and event.value == "RELEASE" and placing.held >= 0:
            placing.held = -1
            return {"RUNNING_MODAL"}
        return {"RUNNING_MODAL"} if placing.held >= 0 else {"PASS_THROUGH"}

    def _hover(self, context: bpy.types.Context, event: bpy.types.Event, seen: Viewport) -> None:
        size, view = (seen.region.width, seen.region.height), np.array(seen.view.perspective_matrix)
        places = landmark_places(required_subject(context), evaluated_depsgraph(context), view, size)
        pixel = (event.mouse_x - seen.region.x, event.mouse_y - seen.region.y)
        landmark = nearest_landmark(places, pixel, NEAR / 2 * context.preferences.system.ui_scale)
        if landmark != context.scene.facemime_steps.landmark:
            context.scene.facemime_steps.landmark = landmark
            redraw(context)


class FACEMIME_OT_mark_face(_PlacesPoints, OnMesh, bpy.types.Operator):
    """Click the requested points of the face one by one, then find the face from them"""

    bl_idname = "facemime.mark_face"
    bl_label = "Mark Face"

    points: StringProperty(name="Points", description="Points to ask for, by iBUG number; empty for all")

    def begin(self, obj: bpy.types.Object) -> Placing:
        return Placing(obj, marks_to_ask([int(IBUG68_INDICES[i]) for i in parse_landmarks(self.points)]))

    def hint(self) -> str:
        return _(
            "Click the point that is shown; Backspace to remove the last point, Enter to find the face, Esc to cancel"
        )

    def handle(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Mark a point by a click, or clear the last one by Backspace."""
        placing = self._placing
        if event.type == "BACK_SPACE" and event.value == "PRESS":
            placing.unmark()
            redraw(context)
            return {"RUNNING_MODAL"}
        seen = viewport_under(context, event.mouse_x, event.mouse_y)
        if seen is None or event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        if (vertex := _vertex_under(context, event, seen)) is None:
            return {"PASS_THROUGH"}
        placing.mark(vertex)
        redraw(context)
        return {"RUNNING_MODAL"} if placing.next_mark is not None else self.end(context)


def _keep(placing: Placing) -> None:
    """Keep the placed points; marked points are then used to find the face."""
    placing.accept()
    if placing.asked and placing.enough:
        bpy.app.timers.register(_find_face, first_interval=0.0)


def _find_face() -> None:
    """Start the search once the marks have their own undo step."""
    with in_a_window():
        search = bpy.ops.facemime.bind_landmarks  # type: ignore[attr-defined]  # registered at run time
        if search.poll():
            search("INVOKE_DEFAULT")


class _EndsPlacing(ReportsErrors):
    """Mixin: a button that ends the placing of points; the operator that waits for clicks then adds the undo step."""

    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require that points are being placed."""
        return placing_on(subject(context)) is not None

    def end(self, placing: Placing) -> None:
        """Keep or discard the points."""
        raise NotImplementedError

    def work(self, context: bpy.types.Context) -> None:
        placing, Placing.current = Placing.current, None
        assert placing is not None
        self.end(placing)
        redraw(context)


class FACEMIME_OT_accept_points(_EndsPlacing, bpy.types.Operator):
    """Keep the points as they are now"""

    bl_idname = "facemime.accept_points"
    bl_label = "Accept"

    def end(self, placing: Placing) -> None:
        _keep(placing)


class FACEMIME_OT_discard_points(_EndsPlacing, bpy.types.Operator):
    """Move the points back to where they were"""

    bl_idname = "facemime.discard_points"
    bl_label = "Discard"

    def end(self, placing: Placing) -> None:
        placing.discard()
