"""Base class, order and layout helpers of the panels in the sidebar tab."""

from collections.abc import Mapping
from typing import Any

import blf
import bpy

from ..blender.meshes import is_head
from ..blender.messages import interface, translated
from ..blender.stubs import Icon, ListMixin, PanelMixin
from ..operators.shared import required_subject, subject
from .documentation import draw_link
from .drawing import wrap

_ORDER = (
    *("start", "head", "source", "calibration", "regions", "control_points", "expression", "puppet"),
    *("takes", "teaching"),
)
"""The panels in the tab, from top to bottom: the order of the workflow."""


def place(panel: str) -> int:
    """Return the `bl_order` of a panel."""
    return _ORDER.index(panel)


_NARROW = 220.0
_HEADER = 76.0
"""Width in the header of a panel, in unscaled pixels, of everything but its title and icons, the tabs at its right
included."""
_INSET = 14.0
"""Width by which the header of a subpanel is indented, in unscaled pixels."""
_ICON = 20.0
"""Width of an icon in the header of a panel, in unscaled pixels."""


class Sidebar(PanelMixin):
    """Mixin: a panel in the sidebar tab Facemime."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Facemime"
    bl_options = {"DEFAULT_CLOSED"}
    header_icons = 0
    """Number of icons and switches in the header besides the link to the documentation."""

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw a link to the documentation at the right of the header, where the title leaves room for it."""
        inset = _INSET if getattr(self, "bl_parent_id", "") else 0.0
        if _has_room(context, self.bl_label, inset + _ICON * (self.header_icons + 1)):
            draw_link(self.layout, type(self).__name__)


class HeadPanel(Sidebar):
    """Mixin: a panel that is shown while the active object is a head."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require an active head."""
        obj = subject(context)
        return obj is not None and is_head(obj)


class List(ListMixin):
    """Mixin: a list whose items are drawn by `draw_row`."""

    def draw_item(  # type: ignore[override]  # Blender passes as many arguments as there are
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: bpy.types.bpy_struct,
        item: Any,
        icon: int,
        active_data: bpy.types.bpy_struct,
        active_property: str,
        index: int,
    ) -> None:
        """Draw one item."""
        self.draw_row(context, layout, item, index)

    def draw_row(self, context: bpy.types.Context, layout: bpy.types.UILayout, item: Any, index: int) -> None:
        """Draw one item, given its place in the list."""
        raise NotImplementedError


def labels(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: Icon = "NONE") -> None:
    """Draw `text`, translated by its template if it is a message, and wrapped to the width of the sidebar."""
    column = layout.column(align=True)
    column.scale_y = 0.9
    for line in wrap(translated(text, interface), _text_width(context)):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else icon


def draw_findings(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the findings of the last check if it was of the active head, with buttons that fix them."""
    memory = context.window_manager.facemime
    if memory.checked != required_subject(context).name:
        return
    if not memory.findings:
        labels(layout, context, "Ready", "CHECKMARK")
    for finding in memory.findings:
        labels(layout, context, finding.problem, "ERROR")
        labels(layout, context, finding.remedy, "BLANK1")
        if finding.step:
            layout.operator(f"facemime.{finding.step}")


def split_labels(layout: bpy.types.UILayout) -> None:
    """Draw settings with their labels in a separate column, and without dots for keyframes."""
    layout.use_property_split = True
    layout.use_property_decorate = False


def props(layout: bpy.types.UILayout, owner: bpy.types.bpy_struct, *names: str) -> None:
    """Draw some properties of `owner`, one below the other."""
    for name in names:
        layout.prop(owner, name)


def draw_list(
    layout: bpy.types.UILayout,
    kind: str,
    owner: bpy.types.PropertyGroup,
    fields: tuple[str, str],
    rows: int,
    buttons: Mapping[str, Icon],
    menu: str = "",
) -> None:
    """Draw a list with buttons next to it, and a menu below them.

    `kind` is the name of the UIList, and `fields` are its collection, and the index of the selected item. There are at
    least `rows` rows. Buttons are an icon for each operator; `menu` is "" for none.
    """
    row = layout.row()
    row.template_list(kind, "", owner, fields[0], owner, fields[1], rows=rows)
    column = row.column(align=True)
    for operator, icon in buttons.items():
        column.operator(f"facemime.{operator}", text="", icon=icon)
    if menu:
        column.separator()
        column.menu(menu, text="", icon="DOWNARROW_HLT")


def side_by_side(layout: bpy.types.UILayout, context: bpy.types.Context) -> bpy.types.UILayout:
    """Return a row for related buttons, or a column if the sidebar is too narrow for a row."""
    return layout.column(align=True) if is_narrow(context) else layout.row(align=True)


def is_narrow(context: bpy.types.Context) -> bool:
    """Return whether the sidebar is hardly wider than a button."""
    return context.region is not None and context.region.width < _NARROW * context.preferences.system.ui_scale


def _has_room(context: bpy.types.Context, title: str, more: float) -> bool:
    """Return whether the header of a panel has room for its title and `more`, in unscaled pixels."""
    if context.region is None:
        return True
    scale = _use_interface_font(context)
    width = blf.dimensions(0, interface(title))[0]
    return width + (_HEADER + more) * scale <= context.region.width


def _text_width(context: bpy.types.Context) -> float:
    """Set the font size of the interface, and return the width available next to an icon, pixels."""
    scale = _use_interface_font(context)
    width = context.region.width if context.region is not None else 300.0
    return max(width - 90.0 * scale, 60.0 * scale)


def _use_interface_font(context: bpy.types.Context) -> float:
    """Set the font size of the interface for `blf`, and return the resolution scale."""
    scale: float = context.preferences.system.ui_scale
    blf.size(0, 11.5 * scale)
    return scale
