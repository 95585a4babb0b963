"""Panels Expression and Puppet, the latter with pose, streams, whole videos and the viewer in a browser."""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..core.puppet.presets import BUILT_IN
from ..core.streams.stream_settings import OWN
from ..core.viewer.viewer_settings import qr_code
from ..operators.puppet import running
from ..sessions.tracking import TrackingSession
from ..settings import user_presets as presets
from ..settings.properties import FacemimeOutput
from ..settings.values import whole_file
from .sidebar import Sidebar, is_narrow, labels, place, props, side_by_side, split_labels
from .status import draw_progress, received, status_lines

_MODULE = 8
"""Pixels per module of the QR code."""


class FACEMIME_MT_presets(bpy.types.Menu):
    """Presets of Facemime, and your own"""

    bl_label = "Presets"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the presets and the operators on them."""
        layout, names = self.layout, presets.names()
        for name, label in BUILT_IN.items():
            button = layout.operator("facemime.load_preset", text=label)
            button.name, button.built_in = name, True
        layout.separator()
        for name in names:
            layout.operator("facemime.load_preset", text=name, translate=False).name = name
        if names:
            layout.separator()
        layout.operator("facemime.save_preset", icon="ADD")
        if names:
            layout.menu("FACEMIME_MT_remove_preset", icon="REMOVE")
        layout.separator()
        layout.operator("facemime.import_preset", icon="IMPORT")
        layout.operator("facemime.export_preset", icon="EXPORT")


class FACEMIME_MT_remove_preset(bpy.types.Menu):
    """Your presets, to remove one"""

    bl_label = "Remove Preset"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the presets."""
        for name in presets.names():
            self.layout.operator("facemime.remove_preset", text=name, translate=False).name = name


class FACEMIME_PT_expression(Sidebar, bpy.types.Panel):
    """Strength of the regions, smoothing, depth and skin."""

    bl_label = "Expression"
    bl_order = place("expression")
    header_icons = 1

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the menu of presets in the header."""
        Sidebar.draw_header_preset(self, context)
        self.layout.menu("FACEMIME_MT_presets", text="", icon="PRESET")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        split_labels(layout)
        settings = context.scene.facemime
        column = layout.column(align=True)
        column.prop(settings, "strength_upper", text="Brows", text_ctxt=CONTEXT)
        column.prop(settings, "strength_middle", text="Cheeks", text_ctxt=CONTEXT)
        column.prop(settings, "strength_lower", text="Jaw", text_ctxt=CONTEXT)
        layout.prop(settings, "smoothing")
        labels(layout, context, "How the skin moves. Start the puppet or preview a take to see what changes", "INFO")
        props(layout, settings, "mode", "kernel", "only_landmarks")


class FACEMIME_PT_fit(Sidebar, bpy.types.Panel):
    """How the skin is fitted to the landmarks."""

    bl_label = "Fit"
    bl_parent_id = "FACEMIME_PT_expression"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        split_labels(layout)
        settings = context.scene.facemime
        labels(layout, context, "For lids, lips and regions that do not meet. The defaults suit most heads", "INFO")
        props(layout, settings, "borders", "exact", "incremental")
        row = layout.row()
        row.active = settings.mode != "planar"
        row.prop(settings, "contact")


class FACEMIME_PT_puppet(Sidebar, bpy.types.Panel):
    """How the heads follow the performer, and the status of the session."""

    bl_label = "Puppet"
    bl_order = place("puppet")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings, session = self.layout, context.scene.facemime, running()
        layout.row().prop(settings, "drive_by", expand=True)
        row = side_by_side(layout, context)
        props(row, settings, "mirror", "keep_pose")
        layout.prop(settings, "hide_bones")
        layout.operator("facemime.next_face", icon="COMMUNITY")
        for text, icon in () if session is None else status_lines(session):
            labels(layout, context, text, icon)


class FACEMIME_PT_pose(Sidebar, bpy.types.Panel):
    """Strength, limits and targets of the pose of the head and the eyes."""

    bl_label = "Head and Eyes"
    bl_parent_id = "FACEMIME_PT_puppet"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.facemime
        split_labels(layout)
        posing = settings.posing
        for switch, prefix in (("rotation", "rotation"), ("translation", "location")):
            layout.prop(settings, switch)
            column = layout.column(align=True)
            column.active = getattr(settings, switch)
            column.prop(posing, f"{prefix}_strength", text="Strength", text_ctxt=CONTEXT)
            column.prop(posing, f"{prefix}_limit", text="Limit", text_ctxt=CONTEXT)
        column = layout.column(align=True)
        column.prop(posing, "eyes_strength", text="Eyes Strength", text_ctxt=CONTEXT)
        column.prop(posing, "eyes_limit", text="Limit", text_ctxt=CONTEXT)
        for target, bone in (("object", "bone"), ("eye_left", "eye_left_bone"), ("eye_right", "eye_right_bone")):
            column = layout.column(align=True)
            column.prop(posing, target)
            obj = getattr(posing, target)
            if obj is not None and obj.type == "ARMATURE":
                column.prop_search(posing, bone, obj.data, "bones", text="Bone", text_ctxt=CONTEXT)


class FACEMIME_PT_send(Sidebar, bpy.types.Panel):
    """Where the performance is sent while the puppet is running."""

    bl_label = "Send"
    bl_parent_id = "FACEMIME_PT_puppet"
    header_icons = 1

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.facemime.output, "enabled", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, output = self.layout, context.scene.facemime.output
        split_labels(layout)
        layout.active = output.enabled
        layout.prop(output, "protocol")
        if output.protocol == OWN:
            layout.prop(output, "across")
            if output.across:
                _draw_paired(layout, output)
                return
        column = layout.column(align=True)
        props(column, output, "host", "port")
        if output.protocol == OWN:
            layout.prop(output, "key")
        elif output.protocol == "livelink":
            layout.prop(output, "subject")
        elif output.protocol == "vmc":
            layout.prop(output, "expressions")


def _draw_paired(layout: bpy.types.UILayout, output: FacemimeOutput) -> None:
    """Draw how paired computers reach this one."""
    column = layout.column(align=True)
    props(column, output, "listen", "port")
    column.prop(output, "public", placeholder=_("This Computer"))
    row = layout.row(align=True)
    row.operator("facemime.copy_pairing_line", icon="COPYDOWN")
    row.operator("facemime.renew_pairing_line", text="", icon="FILE_REFRESH")


class FACEMIME_PT_incoming(Sidebar, bpy.types.Panel):
    """The values that arrive at this moment, for setting up a phone or another sender."""

    bl_label = "Incoming Values"
    bl_parent_id = "FACEMIME_PT_puppet"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running stream."""
        return received() is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        source = received()
        for one in [] if source is None else source.incoming:
            state = one.pose() if one.found else _("No face in view")
            labels(self.layout, context, f"{one.sender}: {one.rate:.0f} fps, {state}", "USER")
            column = self.layout.column_flow(columns=1 if is_narrow(context) else 2, align=True)
            for name, value in one.rows():
                column.progress(factor=value, text=f"{name}  {value:.2f}", translate=False)


class FACEMIME_PT_bake(Sidebar, bpy.types.Panel):
    """Tracking and baking of a whole video or take."""

    bl_label = "Whole Video"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.facemime
        split_labels(layout)
        tracking = TrackingSession.running()
        row = layout.row(align=True)
        if tracking is not None:
            draw_progress(row, tracking)
        elif path := whole_file(settings.source):
            name = _("Track and Bake {name}").format(name=Path(path).name)
            row.operator("facemime.puppet_video", text=name, icon="FILE_MOVIE", translate=False).filepath = path
            row.operator("facemime.puppet_video", text="", icon="FILEBROWSER")
        else:
            row.operator("facemime.puppet_video", icon="FILE_MOVIE")
        column = layout.column(align=True, heading="Neutral", heading_ctxt=CONTEXT)
        column.prop(settings, "find_neutral", text="Find", text_ctxt=CONTEXT)
        row = column.row()
        row.active = not settings.find_neutral
        row.prop(settings, "neutral", text="At", text_ctxt=CONTEXT)


class _Icons:
    """The QR code of the address that is served."""

    previews: bpy.utils.previews.ImagePreviewCollection | None = None
    address = ""


class FACEMIME_PT_viewer(Sidebar, bpy.types.Panel):
    """Whether the running puppet is shown in browsers, and at which address."""

    bl_label = "Viewer"
    bl_parent_id = "FACEMIME_PT_puppet"
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
        props(column, settings, "host", "port", "certificate", "key")
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


def register() -> None:
    """Create the collection of icons."""
    _Icons.previews, _Icons.address = bpy.utils.previews.new(), ""


def unregister() -> None:
    """Remove the collection of icons."""
    bpy.utils.previews.remove(_Icons.previews)
    _Icons.previews, _Icons.address = None, ""
