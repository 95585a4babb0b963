"""What the panels of the sidebar's tab share: where they stand, and their order, which is the order of the work."""

import blf
import bpy

ORDER = ("head", "source", "calibration", "regions", "control_points", "expression", "puppet", "takes")
"""Modules of `ui` whose panels stand in the tab, from above."""


def place(module: str) -> int:
    """For `bl_order`: the place of the panel of `ui.<module>`; its `__name__` will do."""
    return ORDER.index(module.rpartition(".")[2])


_NARROW = 220.0


class Sidebar:
    """Mixin: a panel of the tab Facemime."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Facemime"


def labels(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE") -> None:
    """`text` as lines that fit the sidebar, its `icon` before the first."""
    column = layout.column(align=True)
    column.scale_y = 0.9
    for line in wrapped(bpy.app.translations.pgettext_iface(text), _room(context)):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else icon


def draw_findings(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What the check of the active head found; nothing where it was not the last one that was checked."""
    memory = context.window_manager.facemime
    if memory.checked != context.active_object.name:
        return
    if not memory.findings:
        labels(layout, context, "No fault was found", "CHECKMARK")
    for finding in memory.findings:
        labels(layout, context, finding.problem, "ERROR")
        labels(layout, context, finding.remedy, "BLANK1")
        if finding.step:
            layout.operator(f"facemime.{finding.step}")


def side_by_side(layout: bpy.types.UILayout, context: bpy.types.Context) -> bpy.types.UILayout:
    """A row for what belongs together; a column where the sidebar is too narrow for a row's texts."""
    return layout.column(align=True) if is_narrow(context) else layout.row(align=True)


def is_narrow(context: bpy.types.Context) -> bool:
    """Whether the sidebar has little more than a button's width."""
    return context.region is not None and context.region.width < _NARROW * context.preferences.system.ui_scale


def wrapped(text: str, room: float) -> list[str]:
    """The lines of `text` that are no wider than `room` pixels at the size of interface text; words stay whole."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and blf.dimensions(0, longer)[0] <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _room(context: bpy.types.Context) -> float:
    """Pixels for text beside an icon, and the size of text set to the interface's."""
    scale = context.preferences.system.ui_scale
    blf.size(0, 11.5 * scale)
    width = context.region.width if context.region is not None else 300.0
    return max(width - 90.0 * scale, 60.0 * scale)
