"""The control points of the active head."""

import bpy

from ..blender.meshes import is_head, read_selection
from ..core.landmarks import IBUG68_INDICES
from .sidebar import Sidebar, place

_ROWS = 14


class FACEMIME_PT_control_points(Sidebar, bpy.types.Panel):
    """The control points of the active head, the error after each step, and why each was chosen."""

    bl_label = "Control Points"
    bl_order = place(__name__)
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only for a head."""
        return context.active_object is not None and is_head(context.active_object)

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


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(FACEMIME_PT_control_points)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(FACEMIME_PT_control_points)
