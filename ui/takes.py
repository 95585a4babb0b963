"""Panel Takes: recording, the list of takes, editing and baking."""

import bpy
from bpy.app.translations import pgettext_iface as _

from ..operators.puppet import running
from ..sessions.show import TakeShow
from .sidebar import Sidebar, draw_list, labels, place, split_labels

_MAPPED = "mapped"


class FACEMIME_UL_takes(bpy.types.UIList):
    """List of takes: favourite, name, note, packed, duration."""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        """Draw one take."""
        row = layout.row(align=True)
        row.prop(item, "star", text="", icon="SOLO_ON" if item.star else "SOLO_OFF", emboss=False)
        row.prop(item, "name", text="", emboss=False)
        if item.note:
            row.label(text="", icon="TEXT")
        if item.packed is not None:
            row.label(text="", icon="PACKAGE")
        row.label(text=f"{item.length:.1f} s", translate=False)


class FACEMIME_UL_key_rows(bpy.types.UIList):
    """List of the rows of the key table."""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index) -> None:
        """Draw one row."""
        line = layout.split(factor=0.38, align=True)
        line.prop(item, "source", text="", emboss=False)
        line = line.split(factor=0.6, align=True)
        line.prop(item, "key", text="", emboss=False)
        line.prop(item, "gain", text="", emboss=False)


class FACEMIME_PT_takes(Sidebar, bpy.types.Panel):
    """Recording, the list of takes, and their editing."""

    bl_label = "Takes"
    bl_order = place(__name__)
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, takes = self.layout, context.scene.facemime_takes
        session = running()
        recording, punch_in = (None, None) if session is None else (session.recording, session.punch_in)
        column = layout.column()
        column.scale_y = 1.4
        idle = recording is None
        column.operator(
            "facemime.record_take", text="Record Take" if idle else "Stop Recording", icon="REC", depress=not idle
        )
        row = layout.row()
        row.active = idle
        row.prop(takes, "video")
        if recording is not None:
            labels(layout, context, _("{count} frames recorded").format(count=recording.frames), "DISK_DRIVE")
        elif punch_in is not None:
            labels(layout, context, _("Recording in {seconds:.0f} s").format(seconds=punch_in.time_left), "TIME")
        elif session is None and not len(takes.items):
            labels(layout, context, "Start the puppet to record a take, or import one", "INFO")
        if not bpy.data.filepath and len(takes.items):
            labels(layout, context, "Takes are stored in your user folder until you save the .blend file", "INFO")
        buttons = {
            "import_take": "IMPORT",
            "take_from_animation": "ANIM",
            "export_take": "EXPORT",
            "remove_take": "REMOVE",
            "find_takes": "VIEWZOOM",
        }
        draw_list(layout, "FACEMIME_UL_takes", takes, ("items", "index"), 5, buttons)
        if not 0 <= takes.index < len(takes.items):
            return
        take = takes.items[takes.index]
        layout.prop(take, "note", icon="TEXT")
        layout.operator("facemime.show_take", icon="PLAY", depress=TakeShow.running() is not None)
        row = layout.row(align=True)
        row.operator("facemime.add_sound", text="Sound", icon="SOUND")
        row.operator("facemime.add_reference", text="Video", icon="FILE_MOVIE")
        packed = take.packed is not None
        row.operator("facemime.pack_take", text="Unpack" if packed else "Pack", icon="PACKAGE")
        row = layout.row(align=True)
        row.operator("facemime.trim_take", text="Trim", icon="ARROW_LEFTRIGHT")
        row.operator("facemime.mend_take", text="Mend", icon="MODIFIER")
        row = layout.row(align=True)
        row.operator("facemime.rerecord_take", icon="REC", depress=punch_in is not None)
        row.operator("facemime.punch_in_take", icon="PASTEDOWN")
        layout.operator("facemime.renew_neutral", icon="USER")


class FACEMIME_PT_take_bake(Sidebar, bpy.types.Panel):
    """What the selected take is baked to."""

    bl_label = "Bake"
    bl_parent_id = "FACEMIME_PT_takes"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, bake = self.layout, context.scene.facemime_takes.bake
        split_labels(layout)
        layout.prop(bake, "keys")
        column = layout.column()
        column.active = bake.keys == "new"
        column.prop(bake, "max_keys")
        column = layout.column()
        column.active = bake.keys not in ("cache", "alembic")
        column.prop(bake, "clean")
        layout.prop(bake, "nla")
        layout.operator("facemime.bake_take", icon="ACTION")


class FACEMIME_PT_key_map(Sidebar, bpy.types.Panel):
    """Key table for existing shape keys."""

    bl_label = "Key Table"
    bl_parent_id = "FACEMIME_PT_takes"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, bake = self.layout, context.scene.facemime_takes.bake
        layout.active = bake.keys == _MAPPED
        layout.prop(bake, "table")
        buttons = {
            "add_key_row": "ADD",
            "remove_key_row": "REMOVE",
            "import_key_map": "IMPORT",
            "export_key_map": "EXPORT",
        }
        draw_list(layout, "FACEMIME_UL_key_rows", bake, ("rows", "row"), 5, buttons)
        if 0 <= bake.row < len(bake.rows):
            obj, line = context.active_object, bake.rows[bake.row]
            column = layout.column(align=True)
            column.prop(line, "source")
            if obj is not None and obj.type == "MESH" and obj.data.shape_keys is not None:
                column.prop_search(line, "key", obj.data.shape_keys, "key_blocks")
            else:
                column.prop(line, "key")
            column.prop(line, "gain")
            column.prop(line, "offset")
        layout.operator("facemime.detect_key_map", icon="VIEWZOOM")
        row = layout.row(align=True)
        row.operator("facemime.add_key_pose", icon="ADD")
        row.operator("facemime.learn_key_map", icon="CURVE_DATA")
        row.label(text=str(len(bake.poses)), translate=False)


CLASSES = (
    FACEMIME_UL_takes,
    FACEMIME_UL_key_rows,
    FACEMIME_PT_takes,
    FACEMIME_PT_take_bake,
    FACEMIME_PT_key_map,
)
