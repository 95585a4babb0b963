"""Entries in Blender's menus."""

import bpy


def _add_head(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.add_head", icon="MONKEY")


def _import_facegen(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.import_facegen")


def register() -> None:
    """Add the entries Add > Mesh > Facemime Head and File > Import > FaceGen Head."""
    bpy.types.VIEW3D_MT_mesh_add.append(_add_head)
    bpy.types.TOPBAR_MT_file_import.append(_import_facegen)


def unregister() -> None:
    """Remove the entries."""
    bpy.types.TOPBAR_MT_file_import.remove(_import_facegen)
    bpy.types.VIEW3D_MT_mesh_add.remove(_add_head)
