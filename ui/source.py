"""Panel Source: the camera, video, image sequence or take, and the preview."""

import sys

import bpy

from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..core.live.camera import list_cameras
from ..core.streams.stream_settings import OWN, PROTOCOLS
from ..core.streams.vertices import VERTICES
from ..operators.puppet import running
from ..operators.shared import heads_in
from ..settings.preferences import draw_camera, draw_preview, preferences
from ..settings.stream_properties import FacemimeStream
from ..settings.values import FILE_OF
from .sidebar import Sidebar, labels, place, split_labels

_NUMBERED_CAMERAS = 4


class FACEMIME_PT_source(Sidebar, bpy.types.Panel):
    """Source of the face, and the preview in the viewport."""

    bl_label = "Source"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        split_labels(layout)
        source, chosen = context.scene.facemime.source, preferences()
        layout.prop(source, "kind", text="")
        column = layout.column()
        if source.kind == "CAMERA":
            _draw_camera(column, context)
        elif source.kind == "STREAM":
            _draw_stream(column, source.stream)
            _draw_senders(column, context)
        else:
            if source.kind != "SAMPLE":
                column.prop(source, FILE_OF[source.kind])
            if source.kind == "PICTURES":
                column.prop(source, "rate")
            column.prop(source, "loop")
            column.prop(source, "speed")
        if source.kind not in ("TAKE", "STREAM"):
            column.prop(source, "face")
            column.prop(context.scene.facemime, "detector")
        if source.kind != "STREAM":
            draw_preview(layout, chosen)


def _draw_stream(layout: bpy.types.UILayout, stream: FacemimeStream) -> None:
    layout.prop(stream, "protocol")
    paired = False
    if stream.protocol == OWN:
        layout.prop(preferences(), "pairing")
        paired = bool(preferences().pairing)
    column = layout.column(align=True)
    column.active = not paired
    if PROTOCOLS[stream.protocol].phone_port:
        column.prop(stream, "phone")
    else:
        column.prop(stream, "host")
    column.prop(stream, "port")
    if stream.protocol == OWN:
        column.prop(stream, "key")
    layout.prop(stream, "sender", placeholder=_("First Sender"))
    layout.prop(stream, "delay")
    if stream.protocol == "livelink":
        layout.prop(stream, "angles")
    if stream.protocol not in (OWN, "openseeface", VERTICES):
        layout.row().prop(stream, "flip", expand=True)
        layout.prop(stream, "swap")


def _draw_senders(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the sender of each head, if several are driven."""
    session = running()
    heads = heads_in(context) if session is None else [shown.obj for shown in session.heads if not shown.gone]
    if len(heads) < 2:
        return
    layout.label(text="Senders", text_ctxt=CONTEXT)
    column = layout.column(align=True)
    column.use_property_split = False
    for head in heads:
        row = column.split(factor=0.55, align=True)
        row.label(text=head.name, translate=False)
        row.prop(head.facemime, "sender", text="", placeholder=_("Automatic"))


def _draw_camera(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    chosen = preferences()
    draw_camera(layout, chosen)
    if sys.platform == "darwin":
        labels(
            layout,
            context,
            "macOS asks for permission the first time: start Blender from Terminal and allow access to the camera",
            "INFO",
        )
    elif sys.platform == "linux" and chosen.camera.strip().isdecimal() and not list_cameras():
        labels(layout, context, "No camera found: use a video, or a phone's video stream", "INFO")


class FACEMIME_MT_cameras(bpy.types.Menu):
    """Cameras of this computer; if they cannot be listed, the first numbers"""

    bl_label = "Cameras"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the cameras."""
        numbers = [str(number) for number in range(_NUMBERED_CAMERAS)]
        for camera in [str(camera) for camera in list_cameras()] or numbers:
            self.layout.operator("facemime.choose_camera", text=camera, translate=False).camera = camera


CLASSES = (FACEMIME_MT_cameras, FACEMIME_PT_source)
