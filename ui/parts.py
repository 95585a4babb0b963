"""Panel Character: the parts of the face, and the bones that follow its pose; also shown by a check of the head."""

import bpy

from ..blender.characters import objects_of, part_table, pointed_to, read_bones
from ..blender.meshes import can_be_driven, is_head
from ..blender.messages import CONTEXT
from ..blender.names import HEAD_PROPERTY, PART_OBJECTS, PART_PROPERTY
from ..core.errors import messages
from ..core.heads.parts import PART_NAMES, Part
from ..operators.parts import BONES
from ..operators.shared import subject
from .sidebar import Sidebar, draw_findings, labels

_OWN_PARTS = messages({"tongue": "Tongue", "lashes": "Lashes", "hair": "Hair"})
"""Parts that only built-in heads have."""
_NAMES = 0.5
"""Share of the width for the names of objects and bones."""


class FACEMIME_PT_parts(Sidebar, bpy.types.Panel):
    """The part of the character that each mesh is, which a click changes."""

    bl_label = "Character"
    bl_parent_id = "FACEMIME_PT_head"
    bl_options = {"DEFAULT_CLOSED"}

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
    for obj, part, _ in part_table(head):
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


CLASSES = (FACEMIME_PT_parts, FACEMIME_PT_check)
