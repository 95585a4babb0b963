"""Weight painting of a region, and what is done to painted regions."""

from __future__ import annotations

import bpy

from ...core.errors import HeadError
from ...core.heads.region_edit import Side, mirror_regions, smooth_regions
from ..meshes import mesh_of, read_faces, read_landmarks, read_regions, read_vertices, require_own, write_regions
from ..names import REGION_GROUPS

_BRUSH = "Facemime Paint"


def paint_region(context: bpy.types.Context, obj: bpy.types.Object, region: int) -> None:
    """Put Blender into Weight Paint mode on the group of `region`, a row of `REGION_GROUPS`, with a brush ready.

    Raises
    ------
    HeadError
        Where `obj` is hidden, or its mesh is linked from another file.
    """
    require_own(obj.data)
    if not obj.visible_get():
        raise HeadError(f"{obj.name} is hidden. Show it first.")
    name = REGION_GROUPS[region]
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    obj.vertex_groups.active_index = group.index
    if context.mode != "PAINT_WEIGHT":
        bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
    ensure_brush(context)


def ensure_brush(context: bpy.types.Context) -> None:
    """Choose a brush for weights where none is chosen; make one where Blender came without its own."""
    paint = context.tool_settings.weight_paint
    if paint.brush is not None:
        return
    if bpy.app.version < (4, 3, 0):
        paint.brush = bpy.data.brushes.get("Draw") or bpy.data.brushes.new("Draw", mode="WEIGHT_PAINT")
        return
    brush = bpy.data.brushes.get(_BRUSH) or bpy.data.brushes.new(_BRUSH, mode="WEIGHT_PAINT")
    brush.asset_mark()
    bpy.ops.brush.asset_activate(asset_library_type="LOCAL", relative_asset_identifier=f"Brush/{brush.name}")


def mirror_painted(obj: bpy.types.Object, source: Side) -> None:
    """Make the regions of one half of the head those of the half `source`; HeadError where they are not there."""
    mesh = mesh_of(obj)
    vertices, faces, landmarks = read_vertices(mesh), read_faces(mesh), read_landmarks(obj)
    write_regions(obj, mirror_regions(vertices, faces, landmarks, read_regions(obj), source))


def smooth_painted(obj: bpy.types.Object, repeat: int) -> None:
    """Soften the borders of the regions; HeadError where they are not there."""
    mesh = mesh_of(obj)
    write_regions(obj, smooth_regions(read_vertices(mesh), read_faces(mesh), read_regions(obj), repeat))
