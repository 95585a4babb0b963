"""Panels Source and Calibration: where the performance comes from, its preview, and the performers."""

import sys

import bpy

from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..blender.stubs import Icon
from ..core.puppet.camera_list import CameraList, list_cameras
from ..core.streams.stream_settings import OWN, PROTOCOLS
from ..core.streams.vertices import VERTICES
from ..operators.puppet import running
from ..operators.shared import heads_in
from ..sessions.calibrating import COUNTDOWN
from ..settings.performers import calibration_of, stored_performers
from ..settings.preferences import draw_camera, draw_preview, preferences
from ..settings.properties import FacemimePerformer, FacemimeStream
from ..settings.values import FILE_OF
from .sidebar import List, Sidebar, draw_list, labels, place, props, split_labels
from .status import countdown_text

_NUMBERED_CAMERAS = 4
_PATIENCE = 1.0
"""Seconds for which the menu waits for the list of cameras."""
_CAMERAS = CameraList()


class FACEMIME_PT_source(Sidebar, bpy.types.Panel):
    """Source of the face, and the preview in the viewport."""

    bl_label = "Source"
    bl_order = place("source")

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
            _draw_drivers(column, context, "sender")
        else:
            if source.kind != "SAMPLE":
                column.prop(source, FILE_OF[source.kind])
            if source.kind == "PICTURES":
                column.prop(source, "rate")
            props(column, source, "loop", "speed")
        if source.kind not in ("TAKE", "STREAM"):
            column.prop(source, "face")
            if source.face == "ALL":
                _draw_drivers(column, context, "person")
            props(column, context.scene.facemime, "detector", "tracker_model")
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


def _draw_drivers(layout: bpy.types.UILayout, context: bpy.types.Context, chosen: str) -> None:
    """Draw the property `chosen` of each head, which states who drives it, if several are driven."""
    session = running()
    heads = heads_in(context) if session is None else [shown.obj for shown in session.heads if not shown.gone]
    if len(heads) < 2:
        return
    layout.label(text="People" if chosen == "person" else "Senders", text_ctxt=CONTEXT)
    column = layout.column(align=True)
    column.use_property_split = False
    for head in heads:
        row = column.split(factor=0.55, align=True)
        row.label(text=head.name, translate=False)
        row.prop(head.facemime, chosen, text="", placeholder=_("Automatic"))


def _draw_camera(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    chosen = preferences()
    draw_camera(layout, chosen)
    _CAMERAS.prepare()
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
        for camera in [str(camera) for camera in _CAMERAS.cameras(_PATIENCE)] or numbers:
            self.layout.operator("facemime.choose_camera", text=camera, translate=False).camera = camera


class FACEMIME_UL_performers(List, bpy.types.UIList):
    """List of performers, with a tick for those that are calibrated."""

    def draw_row(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, item: FacemimePerformer, index: int
    ) -> None:
        """Draw one performer."""
        layout.prop(item, "name", text="", emboss=False, icon="CHECKMARK" if calibration_of(item) else "USER")


class FACEMIME_PT_calibration(Sidebar, bpy.types.Panel):
    """List of performers and the calibration buttons."""

    bl_label = "Calibration"
    bl_order = place("calibration")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings, session = self.layout, context.scene.facemime, running()
        buttons: dict[str, Icon] = {"add_performer": "ADD", "remove_performer": "REMOVE"}
        draw_list(layout, "FACEMIME_UL_performers", settings, ("performers", "performer"), 2, buttons)
        if session is None:
            labels(layout, context, "Fits the puppet to your face. Start the puppet first", "INFO")
        column = layout.column(align=True)
        column.operator("facemime.calibrate", text="Neutral Face", icon="USER").pose = "NEUTRAL"
        column.operator("facemime.calibrate", text="Eyes and Mouth", icon="HIDE_OFF").pose = "RANGE"
        column.operator("facemime.reset_calibration", text="Reset", icon="LOOP_BACK")
        props(layout, settings, "learn", "keep_calibrations")
        if stored_performers():
            layout.operator("facemime.clear_calibrations", icon="TRASH")
        if session is None:
            return
        if session.calibrating.current is not None:
            passed = 1.0 - min(session.calibrating.current.left / COUNTDOWN, 1.0)
            layout.progress(factor=passed, text=countdown_text(session), translate=False)
        elif (quality := session.worker.first.quality) is not None:
            labels(layout, context, quality.message, "CHECKMARK" if quality.good else "ERROR")
