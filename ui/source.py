"""Where the face is seen."""

import sys

import bpy

from ..core.live.camera import list_cameras
from ..operators.puppet import running
from .preview import panel_icon
from .sidebar import Sidebar, labels, place


class FACEMIME_PT_source(Sidebar, bpy.types.Panel):
    """The camera, video, pictures or take, and the preview."""

    bl_label = "Source"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        source = context.scene.facemime.source
        layout.prop(source, "kind", text="")
        column = layout.column()
        if source.kind == "CAMERA":
            _draw_camera(column, context, source)
        else:
            if source.kind != "SAMPLE":
                column.prop(source, {"VIDEO": "video", "PICTURES": "folder", "TAKE": "take"}[source.kind])
            if source.kind == "PICTURES":
                column.prop(source, "rate")
            column.prop(source, "loop")
            column.prop(source, "speed")
        row = layout.row(heading="Preview", align=True)
        row.prop(source, "preview", text="")
        size = row.row(align=True)
        size.active = source.preview
        size.prop(source, "preview_size", text="")
        session = running()
        if source.preview and session is not None and (icon := panel_icon(session)):
            layout.template_icon(icon_value=icon, scale=7.0)


def _draw_camera(layout: bpy.types.UILayout, context: bpy.types.Context, source: bpy.types.PropertyGroup) -> None:
    layout.prop(source, "camera")
    column = layout.column(align=True)
    column.prop(source, "width", text="Size")
    column.prop(source, "height", text=" ")
    column.prop(source, "rate")
    if sys.platform == "darwin":
        labels(
            layout,
            context,
            "macOS asks for leave at the first start: start Blender from Terminal, and allow it",
            "INFO",
        )
    elif sys.platform == "linux" and source.camera.strip().isdecimal() and not list_cameras():
        labels(layout, context, "This computer has no camera: use a video, or a telephone's stream", "INFO")


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(FACEMIME_PT_source)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(FACEMIME_PT_source)
