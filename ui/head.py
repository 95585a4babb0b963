"""Panel Head: the built-in head, or the preparation of another mesh."""

import bpy

from ..blender.heads.binding import missing_parts, read_marks
from ..blender.heads.family import character_in, face_candidates, known_keys
from ..blender.meshes import can_be_driven, driven_by_keys, mesh_of
from ..blender.messages import interface as _
from ..operators.shared import subject
from .sidebar import Sidebar, draw_findings, labels, place


class FACEMIME_PT_head(Sidebar, bpy.types.Panel):
    """The steps that the active mesh still needs to become a head."""

    bl_label = "Head"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, obj = self.layout, _subject(context)
        if obj is None:
            labels(layout, context, "Select a character, or add a head")
            return
        missing = missing_parts(obj)
        if not missing:
            layout.label(text=obj.name, icon="CHECKMARK", translate=False)
            if driven_by_keys(obj):
                labels(layout, context, "Driven by its shape keys")
            draw_findings(layout, context)
        for problem, remedy in missing:
            labels(layout, context, problem, "ERROR")
            layout.operator(remedy)
        if missing and known_keys(obj) is not None:
            layout.operator("facemime.bind_keys", icon="SHAPEKEY_DATA")


def _subject(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the head or mesh that the panels are about, or the likely face of the character that is meant."""
    obj = subject(context)
    if obj is not None and obj.type == "MESH":
        return obj
    character = character_in(context)
    return None if character is None else face_candidates(character)[0]


class FACEMIME_PT_own_head(Sidebar, bpy.types.Panel):
    """Buttons that prepare the active mesh as a head."""

    bl_label = "Your Own Head"
    bl_parent_id = "FACEMIME_PT_head"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        obj = _subject(context)
        if obj is None:
            labels(layout, context, "Select a character, or add a head")
            return
        marks = read_marks(mesh_of(obj))
        column = layout.column(align=True)
        if context.mode == "EDIT_MESH":
            column.operator_menu_enum(
                "facemime.mark_point", "point", text=_("Mark Point ({count} marked)").format(count=len(marks))
            )
            column.operator("facemime.set_landmark")
        else:
            if marks:
                marked = _("Marked points: {count}").format(count=len(marks))
                column.label(text=marked, translate=False)
            elif not can_be_driven(obj):
                labels(column, context, "No marks yet. The face is found automatically")
            column.operator("facemime.bind_landmarks", icon="OUTLINER_DATA_ARMATURE")
            memory = context.window_manager.facemime
            wanted = memory.wanted if memory.unsure == obj.name else ""
            column.operator("facemime.mark_face", icon="PIVOT_CURSOR").points = wanted
            column.operator("facemime.adjust_landmarks", icon="CON_TRACKTO")
            column.operator("facemime.propose_regions", icon="GROUP_VERTEX")
            column.operator("facemime.check_head", icon="CHECKMARK")
            column.operator("facemime.open_lips", icon="SCULPTMODE_HLT")
            column.operator("facemime.open_eyes", icon="HIDE_OFF")
        if marks:
            column.operator("facemime.clear_marks")


CLASSES = (FACEMIME_PT_head, FACEMIME_PT_own_head)
