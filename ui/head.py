"""Panels Head, Character and Regions: what a mesh needs to become a head, its parts, and the regions of its face."""

import bpy

from ..blender.characters import objects_of, part_table, pointed_to, read_bones
from ..blender.heads.binding import missing_parts, read_marks
from ..blender.heads.family import character_in, face_candidates, known_keys
from ..blender.meshes import can_be_driven, driven_by_keys, is_head, mesh_of
from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..blender.names import HEAD_PROPERTY, PART_OBJECTS, PART_PROPERTY, REGION_GROUPS
from ..core.errors import messages
from ..core.heads.rig import PART_NAMES, Part
from ..operators.parts import BONES
from ..operators.shared import subject
from .sidebar import HeadPanel, Sidebar, draw_findings, labels, place, side_by_side

_OWN_PARTS = messages({"tongue": "Tongue", "lashes": "Lashes", "hair": "Hair"})
"""Parts that only built-in heads have."""
_NAMES = 0.5
"""Share of the width for the names of objects and bones."""
_BUTTONS = (("UPPER", "Upper"), ("MIDDLE", "Middle"), ("LOWER", "Lower"))


class FACEMIME_PT_head(Sidebar, bpy.types.Panel):
    """The steps that the active mesh still needs to become a head."""

    bl_label = "Head"
    bl_order = place("head")

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


class FACEMIME_PT_parts(Sidebar, bpy.types.Panel):
    """The part of the character that each mesh is, which a click changes."""

    bl_label = "Character"
    bl_parent_id = "FACEMIME_PT_head"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require an active head, or one of its parts."""
        obj = subject(context)
        return obj is not None and obj.type == "MESH" and (can_be_driven(obj) or HEAD_PROPERTY in obj)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, obj = self.layout, subject(context)
        if context.mode == "EDIT_MESH":
            layout.operator_menu_enum("facemime.set_part", "part", text="Set Part of Selected Vertices")
            return
        assert obj is not None, "poll requires it"
        head = obj if can_be_driven(obj) else pointed_to(obj, obj[HEAD_PROPERTY])
        if head is None:
            return
        if not is_head(head):
            _draw_bones(layout, head)
            return
        _draw_parts(layout, head)
        column = layout.column(align=True)
        column.operator("facemime.find_parts", icon="FILE_REFRESH")
        column.operator_menu_enum("facemime.add_part", "part", text="Add Selected")
        _draw_bones(layout, head)
        layout.operator_menu_enum("facemime.make_expression_keys", "keys", icon="SHAPEKEY_DATA")


class FACEMIME_PT_check(bpy.types.Panel):
    """The result of a check, as a popup: problems, and the part or bone that each mesh or bone was found to be."""

    bl_label = "Check Head"
    bl_space_type, bl_region_type = "VIEW_3D", "WINDOW"
    bl_options = {"INSTANCED", "HIDE_HEADER"}
    bl_ui_units_x = 18

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the popup."""
        layout, head = self.layout, subject(context)
        if head is None or not is_head(head):
            return
        layout.label(text=head.name, icon="USER", translate=False)
        draw_findings(layout, context)
        layout.separator()
        _draw_parts(layout, head)
        if read_bones(head)[0] is None:
            labels(layout, context, "No bones: the head turns as a whole")
        else:
            _draw_bones(layout, head)


def _draw_parts(layout: bpy.types.UILayout, head: bpy.types.Object) -> None:
    column = layout.column(align=True)
    others, last = set(objects_of(head)), None
    for obj, part, _count in part_table(head):
        line = column.split(factor=_NAMES, align=True)
        line.label(text=obj.name if obj != last else "", translate=False, icon="MESH_DATA" if obj != last else "BLANK1")
        row = line.row(align=True)
        menu = row.operator_menu_enum("facemime.set_part", "part", text=PART_NAMES[part])
        menu.name, menu.before = obj.name, part.name
        if obj in others and obj != last and PART_PROPERTY not in obj:
            row.operator("facemime.remove_part", text="", icon="X").name = obj.name
        last = obj
    for child in (child for child in head.children if child.get(PART_PROPERTY) in PART_OBJECTS and child not in others):
        line = column.split(factor=_NAMES, align=True)
        line.label(text=child.name, translate=False, icon="MESH_DATA")
        name = child[PART_PROPERTY]
        line.label(text=_OWN_PARTS.get(name) or PART_NAMES[Part[name.upper()]], text_ctxt=CONTEXT)


def _draw_bones(layout: bpy.types.UILayout, head: bpy.types.Object) -> None:
    armature, bones = read_bones(head)
    if armature is None:
        return
    column = layout.column(align=True)
    column.label(text=armature.name, icon="ARMATURE_DATA", translate=False)
    for target, label in BONES.items():
        row = column.split(factor=_NAMES)
        row.label(text=label, text_ctxt=CONTEXT)
        bone = getattr(bones, target)
        row = row.row(align=True)
        row.operator("facemime.set_bone", text=bone or "None", translate=not bone, icon="BONE_DATA").target = target


class FACEMIME_PT_regions(HeadPanel, bpy.types.Panel):
    """Buttons that edit the regions, and the findings of the last check."""

    bl_label = "Regions"
    bl_order = place("regions")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, obj, steps = self.layout, subject(context), context.scene.facemime_steps
        row = side_by_side(layout, context)
        active = obj.vertex_groups.active if obj is not None and context.mode == "PAINT_WEIGHT" else None
        for (region, text), name in zip(_BUTTONS, REGION_GROUPS, strict=True):
            depress = active is not None and active.name == name
            row.operator("facemime.paint_region", text=text, depress=depress).region = region
        if context.mode == "PAINT_WEIGHT":
            layout.operator("facemime.leave_painting", icon="LOOP_BACK")
        row = side_by_side(layout, context)
        row.prop(steps, "show_regions", icon="HIDE_OFF" if steps.show_regions else "HIDE_ON")
        opacity = row.row(align=True)
        opacity.active = steps.show_regions
        opacity.prop(steps, "regions_opacity", text="")
        column = layout.column(align=True)
        row = side_by_side(column, context)
        row.operator("facemime.mirror_regions", text="Left to Right", icon="MOD_MIRROR").source = "left"
        row.operator("facemime.mirror_regions", text="Right to Left").source = "right"
        row = side_by_side(column, context)
        row.operator("facemime.smooth_regions", icon="MOD_SMOOTH").repeat = steps.smooth_repeat
        row.prop(steps, "smooth_repeat", text="")
        column.operator("facemime.propose_regions", icon="GROUP_VERTEX")
        column.operator("facemime.check_head", icon="CHECKMARK")
        draw_findings(layout, context)
