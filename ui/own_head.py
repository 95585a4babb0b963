"""Sub-panels: a head of your own, and its control points."""

import bpy

from ..blender.binding import read_marks
from ..blender.meshes import read_selection
from ..blender.names import LANDMARKS_PROPERTY
from ..core.landmarks import IBUG68_INDICES
from ..operators.shared import register_all, unregister_all

_ROWS = 14


class FACEMIME_PT_own_head(bpy.types.Panel):
    """Buttons that make the active mesh a head."""

    bl_label = "Your Own Head"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Facemime"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        obj = context.active_object
        if obj is None or obj.type != "MESH":
            layout.label(text="Select a mesh")
            return
        marks = read_marks(obj.data)
        column = layout.column(align=True)
        if context.mode == "EDIT_MESH":
            column.operator_menu_enum("facemime.mark_point", "point", text=f"Mark Point ({len(marks)} marked)")
            column.operator("facemime.set_landmark")
        else:
            column.label(text=f"{len(marks)} points marked" if marks else "No points marked: facing -Y, upright")
            column.operator("facemime.bind_landmarks", icon="OUTLINER_DATA_ARMATURE")
            column.operator("facemime.propose_regions", icon="GROUP_VERTEX")
            column.operator("facemime.check_head", icon="CHECKMARK")
        if marks:
            column.operator("facemime.clear_marks")


class FACEMIME_PT_control_points(bpy.types.Panel):
    """The control points of the active head, the error after each step, and why each was chosen."""

    bl_label = "Control Points"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Facemime"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only for a head."""
        obj = context.active_object
        return obj is not None and obj.type == "MESH" and LANDMARKS_PROPERTY in obj.data

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.operator("facemime.select_control_points", text="Select from a Take", icon="CURVE_DATA")
        selection = read_selection(context.active_object.data)
        if selection is None:
            layout.label(text="All 66 landmarks")
            return
        layout.operator("facemime.use_all_landmarks")
        curve = layout.column(align=True)
        curve.label(text=f"Worst error, tolerance {100 * selection.tolerance:.2f} %")
        largest = max(step.error for step in selection.steps)
        every = -(-len(selection.steps) // _ROWS)
        for step in selection.steps[::-1][::every][::-1]:
            text = f"{step.points} points: {100 * step.error:.2f} %"
            curve.progress(factor=step.error / max(largest, 1e-9), text=text)
        points = layout.column(align=True)
        points.label(text="Why each was chosen")
        for landmark in selection.landmarks:
            points.label(text=f"{IBUG68_INDICES[landmark]}: {selection.reason(int(landmark))}")


_CLASSES = (FACEMIME_PT_own_head, FACEMIME_PT_control_points)


def register() -> None:
    """Register the panels."""
    register_all(_CLASSES)


def unregister() -> None:
    """Unregister the panels."""
    unregister_all(_CLASSES)
