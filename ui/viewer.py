"""Panel Viewer: the running puppet in a browser."""

from __future__ import annotations

import bpy
import bpy.utils.previews
import numpy as np

from ..blender.messages import interface as _
from ..core.viewer.qr import qr_code
from ..operators.puppet import running
from .sidebar import Sidebar, labels, side_by_side, split_labels

_MODULE = 8
"""Pixels per module of the QR code."""


class _Icons:
    """The QR code of the address that is served."""

    previews: bpy.utils.previews.ImagePreviewCollection | None = None
    address = ""


class FACEMIME_PT_viewer(Sidebar, bpy.types.Panel):
    """Whether the running puppet is shown in browsers, and at which address."""

    bl_label = "Viewer"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}
    header_icons = 1

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.facemime.viewer, "enabled", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings, session = self.layout, context.scene.facemime.viewer, running()
        column = layout.column()
        split_labels(column)
        column.active = settings.enabled
        column.prop(settings, "host")
        column.prop(settings, "port")
        column.prop(settings, "certificate")
        column.prop(settings, "key")
        row = side_by_side(layout, context)
        row.operator("facemime.open_viewer", icon="URL")
        row.operator("facemime.copy_viewer_address", icon="COPYDOWN")
        server = None if session is None else session.displays.viewer
        if server is None:
            return
        if server.message:
            labels(layout, context, server.message, "ERROR")
        layout.label(text=_("{count} viewers").format(count=server.viewers), icon="HIDE_OFF", translate=False)
        if not server.settings.is_local:
            layout.template_icon(_code(server.address), scale=8.0)


def _code(address: str) -> int:
    """Return the icon of the QR code of an address."""
    previews = _Icons.previews
    assert previews is not None, "made when the panel is registered"
    if _Icons.address != address or "code" not in previews:
        previews.clear()
        icon = previews.new("code")
        light = np.kron(~qr_code(address)[::-1], np.ones((_MODULE, _MODULE), dtype=np.float32))
        icon.image_size = light.shape
        icon.image_pixels_float = np.dstack([light, light, light, np.ones_like(light)]).ravel()  # type: ignore[assignment]  # an array
        _Icons.address = address
    return previews["code"].icon_id


CLASSES = (FACEMIME_PT_viewer,)


def register() -> None:
    """Create the collection of icons."""
    _Icons.previews, _Icons.address = bpy.utils.previews.new(), ""


def unregister() -> None:
    """Remove the collection of icons."""
    bpy.utils.previews.remove(_Icons.previews)
    _Icons.previews, _Icons.address = None, ""
