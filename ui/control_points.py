"""Panel Control Points: the control points of the active head, and the curve of their selection."""

from __future__ import annotations

from functools import lru_cache

import bpy
import bpy.utils.previews

from ..blender.meshes import is_head, mesh_of, read_selection
from ..blender.messages import CONTEXT, translated
from ..blender.messages import interface as _
from ..blender.names import SELECTION_PROPERTY
from ..core.control_points.greedy import WAS_OFF
from ..core.control_points.selection import GreedySelection, from_json
from ..core.control_points.table import PointRow, draw_curve, point_rows
from ..core.errors import FacemimeError, Message
from ..core.face.landmarks import IBUG68_INDICES
from ..core.heads.regions import REGIONS
from ..operators.shared import required_subject, subject
from ..settings.panel_properties import FacemimeLandmark, FacemimeSteps
from .sidebar import HeadPanel, List, is_narrow, labels, place, props, side_by_side, split_labels

_CURVE = "curve"


class _Icons:
    """The image of the curve, and the selection that it shows."""

    previews: bpy.utils.previews.ImagePreviewCollection | None = None
    selection: str = ""


@lru_cache(maxsize=8)
def _selection_rows(text: str) -> list[PointRow]:
    return point_rows(from_json(text) if text else None)


def shown_rows(obj: bpy.types.Object) -> list[PointRow]:
    """Return a row for each landmark of the head `obj`; they are cached until the selection changes."""
    return _selection_rows(str(mesh_of(obj).get(SELECTION_PROPERTY, "")))


class FACEMIME_UL_landmarks(List, bpy.types.UIList):
    """List of landmarks: number, regions, order, and remaining error."""

    def draw_row(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, item: FacemimeLandmark, index: int
    ) -> None:
        """Draw one landmark."""
        obj = subject(context)
        if obj is None or not is_head(obj):
            return
        row = shown_rows(obj)[index]
        layout.active = bool(row.regions)
        names = ", ".join(_(REGIONS[r].name.capitalize()) for r in row.regions)
        number = str(IBUG68_INDICES[index])
        if is_narrow(context):
            layout.label(text=f"{number} {names}", translate=False)
            return
        line = layout.split(factor=0.7)
        line.label(text=f"{number}   {names or '-'}", translate=False)
        line.label(
            text=f"{row.order}: {100 * row.error:.1f}%" if row.order and row.error == row.error else "", translate=False
        )

    def filter_items(  # type: ignore[override]  # Blender takes lists
        self, context: bpy.types.Context, data: bpy.types.bpy_struct, property_name: str
    ) -> tuple[list[int], list[int]]:
        """Sort the control points by their order of selection, before the other landmarks if these are listed."""
        rows = shown_rows(required_subject(context))
        all_listed = not context.scene.facemime_steps.only_chosen
        flags = [self.bitflag_filter_item if row.regions or all_listed else 0 for row in rows]
        wanted = sorted(rows, key=lambda row: (not row.regions, row.order or len(rows), row.landmark))
        places = {row.landmark: n for n, row in enumerate(wanted)}
        return flags, [places[n] for n in range(len(rows))]


class FACEMIME_PT_control_points(HeadPanel, bpy.types.Panel):
    """Selection of control points, the curve of the error, and the list of landmarks."""

    bl_label = "Control Points"
    bl_order = place("control_points")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, obj, steps = self.layout, subject(context), context.scene.facemime_steps
        labels(
            layout, context, "Which of the 66 landmarks move this head. To choose fewer, record a take first", "INFO"
        )
        _draw_selection(layout, steps)
        row = side_by_side(layout, context)
        row.prop(steps, "show_points", icon="HIDE_OFF" if steps.show_points else "HIDE_ON")
        row.operator("facemime.pick_landmark", icon="EYEDROPPER")
        try:
            selection = read_selection(mesh_of(obj))
        except FacemimeError as error:
            labels(layout, context, str(error), "ERROR")
            layout.operator("facemime.use_all_landmarks")
            return
        if selection is None:
            layout.label(text="All 66 landmarks", text_ctxt=CONTEXT)
        else:
            _draw_curve(layout, str(mesh_of(obj)[SELECTION_PROPERTY]), selection)
            layout.operator("facemime.use_all_landmarks")
        _draw_list(layout, context, steps)
        if 0 <= steps.landmark < len(rows := shown_rows(required_subject(context))) and rows[steps.landmark].reason:
            reasons = (Message.read(reason, WAS_OFF) for reason in rows[steps.landmark].reason.split("; "))
            labels(layout, context, "; ".join(translated(reason, _) for reason in reasons), "INFO")


def _draw_selection(layout: bpy.types.UILayout, steps: FacemimeSteps) -> None:
    column = layout.column()
    split_labels(column)
    props(column, steps, "search", "tolerance", "max_points")
    buttons = layout.column(align=True)
    buttons.menu("FACEMIME_MT_select_from_take", icon="CURVE_DATA")
    _apply(steps, buttons.operator("facemime.select_live_points", text="Select from Live", icon="REC"))


def _apply(steps: FacemimeSteps, button: bpy.types.OperatorProperties) -> bpy.types.OperatorProperties:
    """Give a button that selects control points the settings of the panel, and return it."""
    button.tolerance, button.max_points, button.search = steps.tolerance, steps.max_points, steps.search
    return button


class FACEMIME_MT_select_from_take(bpy.types.Menu):
    """Select the landmarks that control the active head in a take; the others follow them"""

    bl_label = "Select from a Take"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the takes of the list, and a file that is not among them."""
        layout, steps = self.layout, context.scene.facemime_steps
        layout.operator_context = "INVOKE_DEFAULT"
        operator = "facemime.select_control_points"
        for place_in_list, take in enumerate(context.scene.facemime_takes.items):
            _apply(steps, layout.operator(operator, text=take.name, translate=False)).take = place_in_list
        if len(context.scene.facemime_takes.items):
            layout.separator()
        _apply(steps, layout.operator(operator, text="From File...", icon="FILEBROWSER"))


def _draw_curve(layout: bpy.types.UILayout, text: str, selection: GreedySelection) -> None:
    if icon := _curve_icon(text, selection):
        layout.template_icon(icon_value=icon, scale=9.0)
    points = _("{count} control points, tolerance {tolerance:.2f} %")
    shown = points.format(count=len(selection.landmarks), tolerance=100 * selection.tolerance)
    layout.label(text=shown, translate=False)


def _curve_icon(text: str, selection: GreedySelection) -> int:
    """Return the icon of the curve, which is drawn again only if the selection has changed."""
    if _Icons.previews is None:
        return 0
    icon = _Icons.previews.get(_CURVE) or _Icons.previews.new(_CURVE)
    if _Icons.selection != text:
        picture = draw_curve(selection)
        icon.image_size = picture.shape[1::-1]
        icon.image_pixels_float.foreach_set(picture.reshape(-1))  # type: ignore[attr-defined]  # it is an array
        _Icons.selection = text
    return icon.icon_id


def _draw_list(layout: bpy.types.UILayout, context: bpy.types.Context, steps: bpy.types.PropertyGroup) -> None:
    row = layout.row()
    row.template_list(
        "FACEMIME_UL_landmarks", "", context.window_manager.facemime, "landmarks", steps, "landmark", rows=5
    )
    column = row.column(align=True)
    column.operator("facemime.add_control_point", text="", icon="ADD")
    column.operator("facemime.drop_control_point", text="", icon="REMOVE")
    column.separator()
    column.prop(steps, "only_chosen", text="", icon="FILTER")


def register() -> None:
    """Create the collection of icons."""
    _Icons.previews = bpy.utils.previews.new()


def unregister() -> None:
    """Remove the collection of icons."""
    bpy.utils.previews.remove(_Icons.previews)
    _Icons.previews, _Icons.selection = None, ""
