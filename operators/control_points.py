"""Operators that select the control points of a head."""

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as _
from bpy.props import IntProperty, StringProperty

from ..blender.contexts import evaluated_depsgraph
from ..blender.heads.placing import NEAR, landmark_places, nearest_landmark
from ..blender.meshes import is_head, mesh_of, read_selection, write_selection
from ..blender.rigs import read_rig
from ..blender.stubs import OperatorResult
from ..blender.viewports import redraw, viewport_under
from ..core.control_points.select import parse_landmarks, select_control_points
from ..core.control_points.selection import SelectionSettings
from ..core.control_points.table import add_by_hand, drop_by_hand
from ..core.errors import HeadError
from ..core.face.landmarks import N_LANDMARKS
from ..core.takes.file import load_take
from ..core.takes.neutral import Neutral, calibrate
from ..core.takes.take import Take
from ..settings import takes_store
from ..settings.rna import read, with_settings
from ..settings.values import puppet_settings
from .puppet import require_puppet, required_puppet
from .shared import AsksForFile, OnHead, OnMesh, report, require, require_mesh, required_subject, subject


@with_settings(SelectionSettings)
class _SelectsPoints(OnMesh):
    """Mixin: selects control points for the operator's `performance`."""

    add: StringProperty(name="Add", description="Landmarks that are always selected, by iBUG number, such as 17,19-21")
    remove: StringProperty(
        name="Remove", description="Landmarks that are never selected, by iBUG number, such as 0-3,30"
    )

    def performance(self, context: bpy.types.Context) -> tuple[Take, Neutral | None]:
        """Return the take to select control points for, and its neutral face if that is known."""
        raise NotImplementedError

    def work(self, context: bpy.types.Context) -> None:
        obj = subject(context)
        take, neutral = self.performance(context)
        chosen = read(SelectionSettings, self)
        selection = select_control_points(
            read_rig(obj),
            take,
            neutral=neutral,
            tolerance=chosen.tolerance,
            max_points=chosen.max_points,
            always=parse_landmarks(self.add),
            never=parse_landmarks(self.remove),
            search=chosen.search,
            kernel=context.scene.facemime.kernel,
        )
        write_selection(mesh_of(obj), selection)
        worst = selection.steps[-1]
        report(
            self,
            "{count} control points, largest error {percent:.2f} % of the face's width at frame {frame}"
            if selection.reached
            else "{count} control points, largest error {percent:.2f} % of the face's width at frame {frame}, "
            "above the tolerance",
            count=len(selection.landmarks),
            percent=100 * worst.error,
            frame=worst.frame,
        )


class FACEMIME_OT_select_control_points(AsksForFile, _SelectsPoints, bpy.types.Operator):
    """Select the landmarks that control the active head in a take; the others follow them"""

    bl_idname = "facemime.select_control_points"
    bl_label = "Select Control Points"

    take: IntProperty(
        name="Take",
        description="Index of the take in the list; -1 for a file",
        default=-1,
        min=-1,
        options={"SKIP_SAVE"},
    )
    filter_glob: StringProperty(default="*.facetake", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Use the take in the list, or otherwise open the file browser."""
        return self.execute(context) if self.take >= 0 else super().invoke(context, event)

    def performance(self, context: bpy.types.Context) -> tuple[Take, Neutral]:
        """Return the take, from the list or at `filepath`, and its neutral face."""
        take = load_take(self.path) if self.take < 0 else takes_store.read(takes_store.at(context.scene, self.take))
        return take, calibrate(take, puppet_settings(context.scene.facemime).neutral)


class FACEMIME_OT_select_live_points(_SelectsPoints, bpy.types.Operator):
    """Select the control points from the last seconds of the puppet; make varied expressions for a few seconds first"""

    bl_idname = "facemime.select_live_points"
    bl_label = "Select from Live"
    needs = (require_puppet, require_mesh)

    def performance(self, context: bpy.types.Context) -> tuple[Take, Neutral]:
        """Return the last seconds of the session and its neutral face."""
        worker = required_puppet().worker
        if worker.first.neutral is None:
            raise HeadError("There is no neutral face yet. Wait until the head moves.")
        return worker.recent_take(), worker.first.neutral


class _OnLandmark(OnHead):
    """Mixin: requires a landmark selected in the panel."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a head and a selected landmark."""
        selected = 0 <= context.scene.facemime_steps.landmark < N_LANDMARKS
        return super().poll(context) and require(cls, selected, "Select a landmark in the list or on the head first")


class FACEMIME_OT_add_control_point(_OnLandmark, bpy.types.Operator):
    """Make the selected landmark a control point"""

    bl_idname = "facemime.add_control_point"
    bl_label = "Add Control Point"

    def work(self, context: bpy.types.Context) -> None:
        mesh = mesh_of(subject(context))
        selection = read_selection(mesh)
        if selection is None:
            raise HeadError("All landmarks are control points already. Remove some first, or select from a take.")
        write_selection(mesh, add_by_hand(selection, context.scene.facemime_steps.landmark))


class FACEMIME_OT_drop_control_point(_OnLandmark, bpy.types.Operator):
    """Remove the selected landmark from the control points, so that it follows the others"""

    bl_idname = "facemime.drop_control_point"
    bl_label = "Remove Control Point"

    def work(self, context: bpy.types.Context) -> None:
        mesh = mesh_of(subject(context))
        write_selection(mesh, drop_by_hand(read_selection(mesh), context.scene.facemime_steps.landmark))


class FACEMIME_OT_pick_landmark(OnHead, bpy.types.Operator):
    """Select a landmark by clicking on the head"""

    bl_idname = "facemime.pick_landmark"
    bl_label = "Pick on Head"
    bl_options = {"REGISTER"}

    def work(self, context: bpy.types.Context) -> OperatorResult:
        """Wait for a click."""
        if bpy.app.background:
            raise HeadError("There is no window to click in. Set the number of the landmark instead.")
        context.scene.facemime_steps.show_points = True
        if context.window is not None:
            context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set(_("Click a landmark; Esc or right-click to cancel"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Handle the click; pass other events through, so that the view can be rotated."""
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            return self.restore(context, {"CANCELLED"})
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        obj = subject(context)
        if obj is None or not is_head(obj):
            return self.restore(context, {"CANCELLED"})
        return self.restore(context, self.reporting(lambda now: self.pick(now, event), context))

    def pick(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Select the landmark nearest to the click."""
        seen = viewport_under(context, event.mouse_x, event.mouse_y)
        if seen is None:
            raise HeadError("The click was not in a 3D Viewport. Press the button again and click on the head.")
        region, view = seen.region, seen.view
        size = (region.width, region.height)
        places = landmark_places(
            required_subject(context), evaluated_depsgraph(context), np.array(view.perspective_matrix), size
        )
        pixel = (event.mouse_x - region.x, event.mouse_y - region.y)
        landmark = nearest_landmark(places, pixel, NEAR * context.preferences.system.ui_scale)
        if landmark < 0:
            raise HeadError("There is no landmark near the click. Click one of the dots.")
        context.scene.facemime_steps.landmark = landmark
        return {"FINISHED"}

    def restore(self, context: bpy.types.Context, outcome: OperatorResult) -> OperatorResult:
        """Restore the cursor and the status bar, and return `outcome`."""
        if context.window is not None:
            context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        redraw(context)
        return outcome


class FACEMIME_OT_use_all_landmarks(OnMesh, bpy.types.Operator):
    """Make all 66 landmarks control points of the active head"""

    bl_idname = "facemime.use_all_landmarks"
    bl_label = "Use All Landmarks"

    def work(self, context: bpy.types.Context) -> None:
        write_selection(mesh_of(subject(context)), None)
