"""Entries in Blender's own menus."""

import bpy


def _add_head(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.add_head", icon="MONKEY")


def register() -> None:
    """Add > Mesh > Facemime Head."""
    bpy.types.VIEW3D_MT_mesh_add.append(_add_head)


def unregister() -> None:
    """Take the entry back."""
    bpy.types.VIEW3D_MT_mesh_add.remove(_add_head)
