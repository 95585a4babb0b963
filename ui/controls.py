"""Panel Controls: the controls of the character's own rig that were learnt."""

from __future__ import annotations

from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from ..blender.controls.checks import slowness
from ..blender.controls.stored import error_curve, has_controls, rig_group
from ..blender.heads.family import armature_of
from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..core.control_points.table import draw_errors
from ..core.errors import messages
from ..core.rigs.control_names import ROLES, role_of
from ..operators.shared import required_subject
from .sidebar import HeadPanel, List, is_narrow, labels, split_labels

_REGIONS = messages({"Brows": "Brows", "Eyes": "Eyes", "Nose": "Nose", "Mouth": "Mouth", "Jaw": "Jaw"})
"""Names of the regions in the interface."""
_CURVE = "curve"
_NAMES = 0.62
"""Share of the width for the names of controls."""


class _Icons:
    """The image of the curve, and what it shows."""

    previews: bpy.utils.previews.ImagePreviewCollection | None = None
    shown: tuple[object, ...] = ()


class FACEMIME_UL_controls(List, bpy.types.UIList):
    """List of controls by region: whether each is used, its name, and what it is."""

    def draw_row(self, context: bpy.types.Context, layout: bpy.types.UILayout, item: Any, index: int) -> None:
        """Draw one control."""
        row = layout.row(align=True)
        row.active = item.use
        row.prop(item, "use", text="")
        if is_narrow(context):
            row.label(text=item.name, translate=False)
            return
        line = row.split(factor=_NAMES)
        line.label(text=item.name, translate=False)
        role = role_of(item.name)
        line.label(text=ROLES[role] if role else _REGIONS.get(item.region, ""), text_ctxt=CONTEXT)


class FACEMIME_PT_controls(HeadPanel, bpy.types.Panel):
    """The controls of the character's own rig."""

    bl_label = "Controls"
    bl_parent_id = "FACEMIME_PT_head"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, head = self.layout, required_subject(context)
        known = has_controls(head)
        layout.operator("facemime.learn_controls", text="Learn Again" if known else "Learn Controls", icon="POSE_HLT")
        if not known:
            labels(layout, context, "Bones and sliders of the character's own rig, which a take can be baked to")
            if armature_of(head) is None:
                layout.operator("facemime.add_face_rig", icon="ARMATURE_DATA")
            return
        group = rig_group(head)
        text = _("{count} controls found; they can show {share} %")
        share = round(100.0 * group.shown)
        layout.label(text=text.format(count=len(group.controls), share=share), translate=False)
        if slow := slowness(head):
            labels(layout, context, slow, "INFO")
        layout.template_list("FACEMIME_UL_controls", "", group, "controls", group, "active", rows=6)
        column = layout.column()
        split_labels(column)
        column.row().prop(context.scene.facemime_steps, "arrows", expand=True)
        _draw_few(layout, context, group, head)
        layout.operator("facemime.export_control_sheet", icon="EXPORT")


def _draw_few(layout: bpy.types.UILayout, context: bpy.types.Context, group: Any, head: bpy.types.Object) -> None:
    """Draw how many controls are used, and the curve of the error."""
    layout.menu("FACEMIME_MT_rank_controls", icon="CURVE_DATA")
    if not (errors := error_curve(head)):
        return
    number = max((count for count in errors if count <= _used(group)), default=min(errors))
    if icon := _curve_icon(errors, errors[number]):
        layout.template_icon(icon_value=icon, scale=9.0)
    layout.prop(group, "few", slider=True)
    text = _("{count} controls leave {error:.1f} % of the motion in {name}")
    name = group.ranked or _("ARKit's expressions")
    shown = text.format(count=number, error=100.0 * errors[number], name=name)
    labels(layout, context, shown)


def _used(group: Any) -> int:
    """Return how many controls the slider uses: both of a pair, once its first one is."""
    return sum(item.order <= group.few for item in group.controls)


def _curve_icon(errors: dict[int, float], level: float) -> int:
    """Return the icon of the curve, which is drawn again only if it has changed."""
    if _Icons.previews is None:
        return 0
    icon = _Icons.previews.get(_CURVE) or _Icons.previews.new(_CURVE)
    if _Icons.shown != (shown := (*errors.items(), level)):
        picture = draw_errors(np.array(list(errors)), np.array(list(errors.values())), level, max(errors))
        icon.image_size = picture.shape[1::-1]
        icon.image_pixels_float.foreach_set(picture.reshape(-1))  # type: ignore[attr-defined]  # it is an array
        _Icons.shown = shown
    return icon.icon_id


class FACEMIME_MT_rank_controls(bpy.types.Menu):
    """Rank the controls by how much they help to show a motion, and use as few as are exact enough"""

    bl_label = "Few Controls to Exact"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw ARKit's expressions, and the takes of the list."""
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        operator = "facemime.rank_controls"
        layout.operator(operator, text="ARKit's Expressions", text_ctxt=CONTEXT).take = -1
        for place_in_list, take in enumerate(context.scene.facemime_takes.items):
            layout.operator(operator, text=take.name, translate=False).take = place_in_list


def register() -> None:
    """Create the collection of icons."""
    _Icons.previews = bpy.utils.previews.new()


def unregister() -> None:
    """Remove the collection of icons."""
    bpy.utils.previews.remove(_Icons.previews)
    _Icons.previews, _Icons.shown = None, ()
