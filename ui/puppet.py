"""Panel Puppet: live puppetry, the pose of head and eyes, and whole videos."""

import bpy

from ..core.streams.settings import OWN
from ..operators.puppet import running
from .sidebar import Sidebar, labels, place, side_by_side, split_labels
from .status import status_lines


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
            column.prop(posing, f"{prefix}_strength", text="Strength")
            column.prop(posing, f"{prefix}_limit", text="Limit")
        column = layout.column(align=True)
        column.prop(posing, "eyes_strength", text="Eyes Strength")
        column.prop(posing, "eyes_limit", text="Limit")
        for target, bone in (("object", "bone"), ("eye_left", "eye_left_bone"), ("eye_right", "eye_right_bone")):
            column = layout.column(align=True)
            column.prop(posing, target)
            obj = getattr(posing, target)
            if obj is not None and obj.type == "ARMATURE":
                column.prop_search(posing, bone, obj.data, "bones", text="Bone")


class FACEMIME_PT_send(Sidebar, bpy.types.Panel):
    """Where the performance is sent while the puppet is running."""

    bl_label = "Send"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.facemime.output, "enabled", text="")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, output = self.layout, context.scene.facemime.output
        split_labels(layout)
        layout.active = output.enabled
        layout.prop(output, "protocol")
        column = layout.column(align=True)
        column.prop(output, "host")
        column.prop(output, "port")
        if output.protocol == OWN:
            layout.prop(output, "key")
        elif output.protocol == "livelink":
            layout.prop(output, "subject")


class FACEMIME_PT_bake(Sidebar, bpy.types.Panel):
    """Tracking and baking of a whole video or take."""

    bl_label = "Whole Video"
    bl_parent_id = "FACEMIME_PT_puppet"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.facemime
        split_labels(layout)
        layout.operator("facemime.puppet_video", icon="FILE_MOVIE")
        column = layout.column(align=True, heading="Neutral")
        column.prop(settings, "find_neutral", text="Find")
        row = column.row()
        row.active = not settings.find_neutral
        row.prop(settings, "neutral", text="At")


CLASSES = (FACEMIME_PT_puppet, FACEMIME_PT_pose, FACEMIME_PT_send, FACEMIME_PT_bake)
