"""Panel Teaching: the examples by which a head is corrected."""

from __future__ import annotations

from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from ..blender.head_properties import FacemimeExample
from ..blender.meshes import can_be_driven
from ..blender.stubs import Icon
from ..blender.styles import read_example, style_group
from ..core.errors import SourceError
from ..core.heads.thumbnail import SIDE, pixels_of
from ..operators.shared import subject
from ..sessions.show import TakeShow
from .sidebar import List, Sidebar, draw_list, labels, place, split_labels

_ICON = 32
"""Width and height of an icon in pixels."""
_PICTURE = 5.0
"""Size of the picture of the selected example, in rows of buttons."""
_previews: dict[str, Any] = {}
"""Blender's collection of the pictures of examples, by their checksum; empty unless the extension is registered."""


def picture_of(item: FacemimeExample) -> int:
    """Return the icon with the picture of an example; 0 without one."""
    if (pictures := _previews.get("examples")) is None or not item.key:
        return 0
    if item.key not in pictures:
        try:
            pixels = pixels_of(read_example(item).thumbnail)
        except SourceError:  # reported when the head is driven
            pixels = None
        if pixels is None:
            return 0
        picture = pictures.new(item.key)
        step = SIDE // _ICON
        small = pixels.reshape(_ICON, step, _ICON, step, 4).mean(axis=(1, 3))
        picture.image_size, picture.icon_size = (SIDE, SIDE), (_ICON, _ICON)
        picture.image_pixels_float.foreach_set(np.ravel(pixels))
        picture.icon_pixels_float.foreach_set(np.ravel(small))
    return int(pictures[item.key].icon_id)


class FACEMIME_UL_examples(List, bpy.types.UIList):
    """List of examples: picture, name, weight, muted."""

    def draw_row(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, item: FacemimeExample, index: int
    ) -> None:
        """Draw one example."""
        row = layout.split(factor=0.65, align=True)
        row.active = not item.mute
        row.prop(item, "name", text="", emboss=False, icon_value=picture_of(item))
        row.prop(item, "weight", text="", slider=True)
        layout.prop(item, "mute", text="", icon="HIDE_ON" if item.mute else "HIDE_OFF", emboss=False)


class FACEMIME_PT_teaching(Sidebar, bpy.types.Panel):
    """Teaching a head by examples."""

    bl_label = "Teaching"
    bl_order = place("teaching")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a head."""
        obj = subject(context)
        return obj is not None and can_be_driven(obj)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, obj = self.layout, subject(context)
        if obj is None:
            return
        head = style_group(obj)
        if TakeShow.running() is None:
            labels(layout, context, "Preview a take on the head to teach it", "INFO")
        elif not len(head.examples):
            labels(layout, context, "Change shape keys in a frame until the head looks right, then teach it", "INFO")
        layout.operator("facemime.suggest_frames", icon="VIEWZOOM")
        layout.operator("facemime.teach_frame", icon="ADD")
        buttons: dict[str, Icon] = {"load_style": "IMPORT", "save_style": "EXPORT", "remove_example": "REMOVE"}
        draw_list(layout, "FACEMIME_UL_examples", head, ("examples", "example"), 3, buttons)
        if 0 <= head.example < len(head.examples):
            item = head.examples[head.example]
            if icon := picture_of(item):
                layout.template_icon(icon, scale=_PICTURE)
            column = layout.column()
            split_labels(column)
            column.prop(item, "performer")
            column.prop(item, "weight", slider=True)


def register() -> None:
    """Create the collection of pictures."""
    _previews["examples"] = bpy.utils.previews.new()


def unregister() -> None:
    """Remove the collection of pictures."""
    if (pictures := _previews.pop("examples", None)) is not None:
        bpy.utils.previews.remove(pictures)
