"""Choose the control points that a head needs for a take."""

import bpy
import numpy as np
from bpy.props import FloatProperty, IntProperty, StringProperty

from ..blender.heads.landmark_places import NEAR, landmark_places, nearest_landmark
from ..blender.meshes import is_head, read_rig, read_selection, write_selection
from ..blender.viewports import redraw, viewport_under
from ..core.control_points.select import parse_landmarks, select_for_take
from ..core.control_points.table import add_by_hand, drop_by_hand
from ..core.errors import HeadError
from ..core.landmarks import N_LANDMARKS
from ..core.takes.file import load_take
from ..core.takes.neutral import Neutral, calibrate
from ..core.takes.take import Take
from ..settings.values import puppet_settings
from .puppet import running
from .shared import AsksForFile, OnHead, OnMesh


class SelectsPoints(OnMesh):
    """Mixin: chooses control points for a `performance`."""

    tolerance: FloatProperty(
        name="Tolerance",
        description="How far a landmark that is no control point may end from where it was, of the face's width",
        subtype="PERCENTAGE",
        default=1.0,
        min=0.01,
        max=100.0,
        soft_max=10.0,
    )
    max_points: IntProperty(name="At Most", description="Control points", default=N_LANDMARKS, min=3, max=N_LANDMARKS)
    add: StringProperty(name="Add", description="Landmarks to have in any case, by iBUG number: 17,19-21")
    remove: StringProperty(name="Remove", description="Landmarks never to have, by iBUG number: 0-3,30")

    def work(self, context: bpy.types.Context) -> set[str]:
        obj = context.active_object
        take, neutral = self.performance(context)
        selection = select_for_take(
            read_rig(obj),
            take,
            neutral=neutral,
            tolerance=self.tolerance / 100.0,
            max_points=self.max_points,
            always=parse_landmarks(self.add),
            never=parse_landmarks(self.remove),
        )
        write_selection(obj.data, selection)
        worst = selection.steps[-1]
        short = "" if selection.reached else ", short of the tolerance"
        self.report(
            {"INFO"},
            f"{len(selection.landmarks)} control points, worst error {100 * worst.error:.2f} % of the face's width "
            f"in frame {worst.frame}{short}",
        )
        return {"FINISHED"}


class FACEMIME_OT_select_control_points(AsksForFile, SelectsPoints, bpy.types.Operator):
    """Choose, from a take, the landmarks that control the active head; the others follow"""

    bl_idname = "facemime.select_control_points"
    bl_label = "Select Control Points"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(name="Take", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default="*.facetake", options={"HIDDEN"})

    def performance(self, context: bpy.types.Context) -> tuple[Take, Neutral]:
        """What the points are chosen for: the take of `filepath`, and the performer at rest in it."""
        take = load_take(self.path)
        return take, calibrate(take, puppet_settings(context.scene.facemime).neutral)


class FACEMIME_OT_select_live_points(SelectsPoints, bpy.types.Operator):
    """Choose the control points from what the puppet has shown lately; grimace for some seconds first"""

    bl_idname = "facemime.select_live_points"
    bl_label = "Select from Live"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while the puppet runs, on a mesh."""
        if running() is None:
            cls.poll_message_set("Start the puppet first: step Puppet, below")
            return False
        return super().poll(context)

    def performance(self, context: bpy.types.Context) -> tuple[Take, Neutral]:
        """The last seconds of the session, and its neutral."""
        worker = running().worker
        if worker.neutral is None:
            raise HeadError("The neutral face is not known yet. Wait until the head moves.")
        return worker.recent_take(), worker.neutral


class OnLandmark(OnHead):
    """Mixin: needs the landmark that is picked in the panel."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a landmark picked."""
        if not super().poll(context):
            return False
        if not 0 <= context.scene.facemime_steps.landmark < N_LANDMARKS:
            cls.poll_message_set("Pick a landmark in the list or on the head first")
            return False
        return True


class FACEMIME_OT_add_control_point(OnLandmark, bpy.types.Operator):
    """Make the picked landmark a control point"""

    bl_idname = "facemime.add_control_point"
    bl_label = "Add Control Point"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        mesh = context.active_object.data
        selection = read_selection(mesh)
        if selection is None:
            raise HeadError("All landmarks are control points already. Drop some first, or select from a take.")
        write_selection(mesh, add_by_hand(selection, context.scene.facemime_steps.landmark))
        return {"FINISHED"}


class FACEMIME_OT_drop_control_point(OnLandmark, bpy.types.Operator):
    """Let the picked landmark follow the others: it is no control point any longer"""

    bl_idname = "facemime.drop_control_point"
    bl_label = "Drop Control Point"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        mesh = context.active_object.data
        write_selection(mesh, drop_by_hand(read_selection(mesh), context.scene.facemime_steps.landmark))
        return {"FINISHED"}


class FACEMIME_OT_pick_landmark(OnHead, bpy.types.Operator):
    """Pick a landmark by a click on the head"""

    bl_idname = "facemime.pick_landmark"
    bl_label = "Pick on Head"
    bl_options = {"REGISTER"}

    def work(self, context: bpy.types.Context) -> set[str]:
        """Wait for the click."""
        if bpy.app.background:
            raise HeadError("There is no window to click in. Set the landmark's number instead.")
        context.scene.facemime_steps.show_points = True
        context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set("Click a landmark; ESC or the right button to leave")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Pick with the click; let everything else pass, such as turning the view."""
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            return self.leave(context, {"CANCELLED"})
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        if context.active_object is None or not is_head(context.active_object):
            return self.leave(context, {"CANCELLED"})
        return self.leave(context, self.reporting(lambda now: self.pick(now, event), context))

    def pick(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Pick what is nearest to the click."""
        seen = viewport_under(context, event.mouse_x, event.mouse_y)
        if seen is None:
            raise HeadError("That was not in a 3D viewport. Press the button again and click on the head.")
        region, view = seen
        size = (region.width, region.height)
        places = landmark_places(
            context.active_object, context.evaluated_depsgraph_get(), np.array(view.perspective_matrix), size
        )
        pixel = (event.mouse_x - region.x, event.mouse_y - region.y)
        landmark = nearest_landmark(places, pixel, NEAR * context.preferences.system.ui_scale)
        if landmark < 0:
            raise HeadError("No landmark is near that place. Click one of the dots.")
        context.scene.facemime_steps.landmark = landmark
        return {"FINISHED"}

    def leave(self, context: bpy.types.Context, outcome: set[str]) -> set[str]:
        """Give the cursor back."""
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        redraw(context)
        return outcome


class FACEMIME_OT_use_all_landmarks(OnMesh, bpy.types.Operator):
    """Let all 66 landmarks control the active head again"""

    bl_idname = "facemime.use_all_landmarks"
    bl_label = "Use All Landmarks"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        write_selection(context.active_object.data, None)
        return {"FINISHED"}


CLASSES = (
    FACEMIME_OT_select_control_points,
    FACEMIME_OT_select_live_points,
    FACEMIME_OT_use_all_landmarks,
    FACEMIME_OT_add_control_point,
    FACEMIME_OT_drop_control_point,
    FACEMIME_OT_pick_landmark,
)
