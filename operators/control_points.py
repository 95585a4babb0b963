"""Choose the control points that a head needs for a take."""

from pathlib import Path

import bpy
from bpy.props import FloatProperty, IntProperty, StringProperty

from ..blender.meshes import read_rig, write_selection
from ..core.control_points import parse_landmarks, select_for_take
from ..core.landmarks import N_LANDMARKS
from ..core.retarget import calibrate
from ..core.takes.file import load_take
from ..settings import puppet_settings
from .shared import AsksForFile, OnMesh, register_all, unregister_all


class FACEMIME_OT_select_control_points(AsksForFile, OnMesh, bpy.types.Operator):
    """Choose, from a take, the landmarks that control the active head; the others follow."""

    bl_idname = "facemime.select_control_points"
    bl_label = "Select Control Points"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(name="Take", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default="*.facetake", options={"HIDDEN"})
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
        """The work of `execute`."""
        rig = read_rig(context.active_object)
        take = load_take(Path(bpy.path.abspath(self.filepath)))
        selection = select_for_take(
            rig,
            take,
            neutral=calibrate(take, puppet_settings(context.scene.facemime).neutral),
            tolerance=self.tolerance / 100.0,
            max_points=self.max_points,
            always=parse_landmarks(self.add),
            never=parse_landmarks(self.remove),
        )
        write_selection(context.active_object.data, selection)
        worst = selection.steps[-1]
        short = "" if selection.reached else ", short of the tolerance"
        self.report(
            {"INFO"},
            f"{len(selection.landmarks)} control points, worst error {100 * worst.error:.2f} % of the face's width "
            f"in frame {worst.frame}{short}",
        )
        return {"FINISHED"}


class FACEMIME_OT_use_all_landmarks(OnMesh, bpy.types.Operator):
    """Let all 66 landmarks control the active head again."""

    bl_idname = "facemime.use_all_landmarks"
    bl_label = "Use All Landmarks"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        """The work of `execute`."""
        write_selection(context.active_object.data, None)
        return {"FINISHED"}


_CLASSES = (FACEMIME_OT_select_control_points, FACEMIME_OT_use_all_landmarks)


def register() -> None:
    """Register the operators."""
    register_all(_CLASSES)


def unregister() -> None:
    """Unregister the operators."""
    unregister_all(_CLASSES)
