"""Panel Takes: recording, the list of takes, editing and baking."""

import bpy

from ..blender.animation.conflicts import playing_under
from ..blender.animation.corrections import can_be_corrected, has_layer
from ..blender.animation.refit import keyframe_count
from ..blender.animation.strengths import STRENGTHS
from ..blender.meshes import can_be_driven, mesh_of
from ..blender.messages import interface as _
from ..blender.stubs import Icon
from ..core.bake.bake_settings import AUTOMATIC
from ..core.takes.table_times import timecode
from ..operators.puppet import running
from ..operators.shared import subject
from ..sessions.landmark_edit import LandmarkEdit
from ..sessions.show import TakeShow
from ..settings import takes_store
from ..settings.takes_properties import FacemimeKeyRow, FacemimeTake, table_so_far
from .sidebar import List, Sidebar, draw_list, labels, place, props, split_labels

_MAPPED = "mapped"


class FACEMIME_UL_takes(List, bpy.types.UIList):
    """List of takes: favourite, name, note, packed, duration."""

    def draw_row(self, context: bpy.types.Context, layout: bpy.types.UILayout, item: FacemimeTake, index: int) -> None:
        """Draw one take."""
        row = layout.row(align=True)
        row.prop(item, "star", text="", icon="SOLO_ON" if item.star else "SOLO_OFF", emboss=False)
        row.prop(item, "name", text="", emboss=False)
        if item.note:
            row.label(text="", icon="TEXT")
        if item.packed is not None:
            row.label(text="", icon="PACKAGE")
        row.label(text=timecode(item.length), translate=False)


class FACEMIME_UL_key_rows(List, bpy.types.UIList):
    """List of the rows of the key mapping; the selected one has its factors below the list."""

    def draw_row(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, item: FacemimeKeyRow, index: int
    ) -> None:
        """Draw one row."""
        line = layout.split(factor=0.5, align=True)
        line.label(text=item.source, translate=False)
        line.prop(item, "key", text="", emboss=False)


class FACEMIME_PT_takes(Sidebar, bpy.types.Panel):
    """Recording, the list of takes, and their editing."""

    bl_label = "Takes"
    bl_order = place("takes")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, takes = self.layout, context.scene.facemime_takes
        session = running()
        punch_in = None if session is None else session.recorder.punch_in
        recording = session is not None and session.recorder.recording is not None
        if punch_in is not None and not recording:
            labels(layout, context, _("Recording in {seconds:.0f} s").format(seconds=punch_in.time_left), "TIME")
        elif not len(takes.items):
            labels(
                layout,
                context,
                "The take is listed when you stop" if recording else "Record a take, or import one",
                "INFO",
            )
        elif not bpy.data.filepath:
            labels(layout, context, "Takes are in your documents until you save the .blend file", "INFO")
        buttons: dict[str, Icon] = {"import_take": "IMPORT", "remove_take": "REMOVE"}
        draw_list(layout, "FACEMIME_UL_takes", takes, ("items", "index"), 3, buttons, menu="FACEMIME_MT_takes")
        column = layout.column()
        split_labels(column)
        column.prop(takes, "countdown")
        if not 0 <= takes.index < len(takes.items):
            return
        take = takes.items[takes.index]
        column.prop(take, "note", icon="TEXT")
        column = layout.column(align=True)
        column.operator("facemime.show_take", icon="PLAY", depress=TakeShow.running() is not None)
        row = column.row(align=True)
        row.operator("facemime.trim_take", text="Trim", icon="ARROW_LEFTRIGHT")
        row.operator("facemime.mend_take", text="Mend", icon="MODIFIER")
        row = column.row(align=True)
        row.operator("facemime.edit_landmarks", icon="EMPTY_AXIS", depress=LandmarkEdit.current is not None)
        row.operator("facemime.next_doubtful_frame", text="", icon="VIEWZOOM")
        edit = LandmarkEdit.current
        if edit is not None and not edit.has_video and edit.path == take.path:
            column.prop(take, "video")
        if takes_store.has_pins(take):
            column.operator("facemime.learn_from_pins", icon="LIGHT", depress=takes_store.learns(take))
        if session is not None:
            column.operator("facemime.rerecord_take", icon="REC", depress=punch_in is not None)


class FACEMIME_MT_takes(bpy.types.Menu):
    """More operators on takes"""

    bl_label = "Takes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators."""
        layout, takes = self.layout, context.scene.facemime_takes
        layout.prop(takes, "video")
        layout.separator()
        layout.operator("facemime.take_from_animation", icon="ANIM")
        layout.operator("facemime.find_takes", icon="VIEWZOOM")
        layout.operator("facemime.export_take", icon="EXPORT")
        layout.operator("facemime.export_gltf", icon="EXPORT")
        layout.separator()
        layout.operator("facemime.add_sound", icon="SOUND")
        layout.operator("facemime.add_reference", icon="FILE_MOVIE")
        chosen = takes.items[takes.index] if 0 <= takes.index < len(takes.items) else None
        packed = chosen is not None and chosen.packed is not None
        layout.operator("facemime.pack_take", text="Unpack Take" if packed else "Pack Take", icon="PACKAGE")
        layout.operator("facemime.remove_take", icon="REMOVE")
        layout.separator()
        layout.operator("facemime.rerecord_take", icon="REC")
        layout.operator("facemime.punch_in_take", icon="PASTEDOWN")
        layout.operator("facemime.learn_from_pins", icon="LIGHT")
        layout.operator("facemime.renew_neutral", icon="USER")


class FACEMIME_PT_take_bake(Sidebar, bpy.types.Panel):
    """Settings for baking the selected take."""

    bl_label = "Bake"
    bl_parent_id = "FACEMIME_PT_takes"
    bl_options = set()

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, bake = self.layout, context.scene.facemime_takes.bake
        split_labels(layout)
        layout.prop(bake, "keys", text="")
        layout.operator("facemime.bake_take", icon="ACTION")  # above the options, in view on small screens
        column = layout.column()
        column.active = bake.keys in (AUTOMATIC, "new")
        column.prop(bake, "max_keys")
        column = layout.column()
        column.active = bake.keys in (AUTOMATIC, "named")
        column.prop(bake, "residual")
        column = layout.column()
        column.active = bake.keys in (AUTOMATIC, "new", "named")
        column.prop(bake, "positive")
        column = layout.column()
        column.active = bake.keys not in ("cache", "alembic")
        column.prop(bake, "whole_frames")
        column = column.column()
        column.active = bake.whole_frames
        column.prop(bake, "detail", slider=True)
        if bake.whole_frames and bake.clean > 0.0:
            labels(column, context, _("Error of curves: {error:.2f} %").format(error=bake.clean))
        if (head := subject(context)) is not None and head.type == "MESH" and (count := keyframe_count(head)):
            labels(column, context, _("Baked: {count} keyframes").format(count=count))
        props(layout, bake, "start", "fit_range", "keep_animation", "nla")
        obj = subject(context)
        if obj is not None and can_be_driven(obj) and (others := playing_under(obj)):
            labels(layout, context, _("Also moves the shape keys: {names}").format(names=", ".join(others)), "INFO")
            layout.operator("facemime.mute_others", icon="MUTE_IPO_ON")
        if obj is not None and can_be_driven(obj):
            if has_layer(obj):
                labels(layout, context, _("Keyframes are added to the bake"), "NLA_PUSHDOWN")
                layout.operator("facemime.remove_corrections", icon="X")
            elif can_be_corrected(obj):
                layout.operator("facemime.add_corrections", icon="NLA_PUSHDOWN")


class FACEMIME_PT_strengths(Sidebar, bpy.types.Panel):
    """Strengths of the parts of the active head in bakes."""

    bl_label = "Strengths in the Bake"
    bl_parent_id = "FACEMIME_PT_take_bake"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there is a head."""
        obj = subject(context)
        return obj is not None and can_be_driven(obj)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        split_labels(self.layout)
        if (head := subject(context)) is not None:
            for name in STRENGTHS.values():
                self.layout.prop(head.facemime, name, slider=True)


class FACEMIME_PT_key_map(Sidebar, bpy.types.Panel):
    """Key mapping for existing shape keys."""

    bl_label = "Key Mapping"
    bl_parent_id = "FACEMIME_PT_takes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, bake = self.layout, context.scene.facemime_takes.bake
        layout.active = bake.keys in (AUTOMATIC, _MAPPED)
        column = layout.column()
        split_labels(column)
        column.prop(bake, "table")
        buttons: dict[str, Icon] = {
            "add_key_row": "ADD",
            "remove_key_row": "REMOVE",
            "import_key_map": "IMPORT",
            "export_key_map": "EXPORT",
        }
        layout.template_list("FACEMIME_UL_key_rows", "", bake, "rows", bake, "row", rows=5)
        row = layout.row(align=True)
        for operator, icon in buttons.items():
            row.operator(f"facemime.{operator}", text="", icon=icon)
        if 0 <= bake.row < len(bake.rows):
            obj, line = subject(context), bake.rows[bake.row]
            column = layout.column(align=True)
            split_labels(column)
            column.prop(line, "source")
            if obj is not None and obj.type == "MESH" and mesh_of(obj).shape_keys is not None:
                column.prop_search(line, "key", mesh_of(obj).shape_keys, "key_blocks")
            else:
                column.prop(line, "key")
            props(column, line, "gain", "offset")
        layout.operator("facemime.detect_key_map", text="Detect", icon="VIEWZOOM")
        if bake.rows:
            labels(layout, context, table_so_far(bake).summary())
        column = layout.column(align=True)
        added = _("Add Pose ({count} added)").format(count=len(bake.poses))
        column.operator("facemime.add_key_pose", text=added, translate=False, icon="ADD")
        column.operator("facemime.learn_key_map", icon="CURVE_DATA")
