"""Panel Puppet: live puppetry, the pose of head and eyes, and whole videos."""

from pathlib import Path

import bpy

from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..core.streams.stream_settings import OWN
from ..operators.puppet import running
from ..sessions.tracking import TrackingSession
from ..settings.stream_properties import FacemimeOutput
from ..settings.values import whole_file
from .sidebar import Sidebar, is_narrow, labels, place, side_by_side, split_labels
from .status import draw_progress, received, status_lines


class FACEMIME_PT_puppet(Sidebar, bpy.types.Panel):
    """How the heads follow the performer, and the status of the session."""

    bl_label = "Puppet"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings, session = self.layout, context.scene.facemime, running()
        layout.row().prop(settings, "drive_by", expand=True)
        row = side_by_side(layout, context)
        row.prop(settings, "mirror")
        row.prop(settings, "keep_pose")
        layout.prop(settings, "hide_bones")
        layout.operator("facemime.next_face", icon="COMMUNITY")
        for text, icon in () if session is None else status_lines(session):
            labels(layout, context, text, icon)


class FACEMIME_PT_pose(Sidebar, bpy.types.Panel):
    """Strength, limits and targets of the pose of the head and the eyes."""

    bl_label = "Head and Eyes"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}

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
    bl_options = {"DEFAULT_CLOSED"}
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
        column.prop(output, "host")
        column.prop(output, "port")
        if output.protocol == OWN:
            layout.prop(output, "key")
        elif output.protocol == "livelink":
            layout.prop(output, "subject")
        elif output.protocol == "vmc":
            layout.prop(output, "expressions")


def _draw_paired(layout: bpy.types.UILayout, output: FacemimeOutput) -> None:
    """Draw how paired computers reach this one."""
    column = layout.column(align=True)
    column.prop(output, "listen")
    column.prop(output, "port")
    column.prop(output, "public", placeholder=_("This Computer"))
    row = layout.row(align=True)
    row.operator("facemime.copy_pairing_line", icon="COPYDOWN")
    row.operator("facemime.renew_pairing_line", text="", icon="FILE_REFRESH")


class FACEMIME_PT_incoming(Sidebar, bpy.types.Panel):
    """The values that arrive at this moment, for setting up a phone or another sender."""

    bl_label = "Incoming Values"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}

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
    bl_options = {"DEFAULT_CLOSED"}

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


CLASSES = (FACEMIME_PT_puppet, FACEMIME_PT_pose, FACEMIME_PT_send, FACEMIME_PT_incoming, FACEMIME_PT_bake)
