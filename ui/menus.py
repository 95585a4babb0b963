"""Entries in Blender's menus."""

from typing import ClassVar

import bpy


def _add_head(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.add_head", icon="MONKEY")


def _import_facegen(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.import_facegen")


_ENTRIES = (
    (
        ("facemime.puppet", "PLAY"),
        ("facemime.stop_puppet", "SNAP_FACE"),
        ("facemime.record_take", "REC"),
        ("facemime.next_face", "COMMUNITY"),
    ),
    (
        ("facemime.puppet_video", "FILE_MOVIE"),
        ("facemime.take_from_animation", "ANIM"),
        ("facemime.import_take", "IMPORT"),
        ("facemime.export_take", "EXPORT"),
        ("facemime.show_take", "HIDE_OFF"),
        ("facemime.trim_take", "ARROW_LEFTRIGHT"),
        ("facemime.mend_take", "MODIFIER"),
        ("facemime.bake_take", "ACTION"),
        ("facemime.export_gltf", "EXPORT"),
    ),
    (
        ("facemime.bind_landmarks", "VIEWZOOM"),
        ("facemime.bind_keys", "SHAPEKEY_DATA"),
        ("facemime.mark_face", "PIVOT_CURSOR"),
        ("facemime.adjust_landmarks", "CON_TRACKTO"),
        ("facemime.check_head", "CHECKMARK"),
        ("facemime.propose_regions", "GROUP_VERTEX"),
        ("facemime.open_lips", "SCULPTMODE_HLT"),
        ("facemime.open_eyes", "HIDE_OFF"),
        ("facemime.make_expression_keys", "SHAPEKEY_DATA"),
    ),
)
"""Operators of the menu Facemime with their icons, in groups: live, takes, heads."""
_KEYS = (("facemime.puppet", "P"), ("facemime.stop_puppet", "P"), ("facemime.record_take", "R"))
"""Operators and their keys, with Shift and Alt: the first one that can run does."""


class VIEW3D_MT_facemime(bpy.types.Menu):
    """Everything that Facemime does, so that Blender's search finds it"""

    bl_label = "Facemime"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators."""
        layout = self.layout
        layout.operator_context = "INVOKE_REGION_WIN"
        layout.menu("FACEMIME_MT_add", icon="ADD")
        for group in _ENTRIES:
            layout.separator()
            for operator, icon in group:
                layout.operator(operator, icon=icon)
        layout.menu("FACEMIME_MT_select_from_take", icon="CURVE_DATA")


def _facemime(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    if context.mode == "OBJECT":
        menu.layout.menu("VIEW3D_MT_facemime")


class _Keys:
    """The shortcuts that were added."""

    added: ClassVar[list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]]] = []


CLASSES = (VIEW3D_MT_facemime,)


def register() -> None:
    """Add the menu Facemime, the entries Add > Mesh > Facemime Head and File > Import > FaceGen Head, and shortcuts."""
    bpy.types.VIEW3D_MT_editor_menus.append(_facemime)
    bpy.types.VIEW3D_MT_mesh_add.append(_add_head)
    bpy.types.TOPBAR_MT_file_import.append(_import_facegen)
    if (configuration := bpy.context.window_manager.keyconfigs.addon) is not None:  # there is none without a window
        keymap = configuration.keymaps.new(name="3D View", space_type="VIEW_3D")
        for operator, key in _KEYS:
            _Keys.added.append((keymap, keymap.keymap_items.new(operator, key, "PRESS", shift=True, alt=True)))


def unregister() -> None:
    """Remove the entries and shortcuts."""
    for keymap, item in _Keys.added:
        keymap.keymap_items.remove(item)
    _Keys.added.clear()
    bpy.types.VIEW3D_MT_editor_menus.remove(_facemime)
    bpy.types.TOPBAR_MT_file_import.remove(_import_facegen)
    bpy.types.VIEW3D_MT_mesh_add.remove(_add_head)
