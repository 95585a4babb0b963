"""Weight painting, mirroring and smoothing of regions."""

from __future__ import annotations

import bpy

from ...core.errors import HeadError
from ...core.heads.regions import Side, hold_landmarks, mirror_regions, own_weights, smooth_regions
from ..meshes import mesh_of, read_faces, read_landmarks, read_regions, read_vertices, require_own, write_regions
from ..names import REGION_GROUPS
from ..view_layers import select_alone

_BRUSH = "Facemime Paint"
_FULL = 0.99
"""Minimum weight of a landmark in its regions, which smoothing preserves."""


def paint_region(context: bpy.types.Context, obj: bpy.types.Object, region: int) -> None:
    """Switch to Weight Paint Mode on the vertex group of a region, an index in `REGION_GROUPS`, with a brush.

    Raises HeadError if the head is hidden, or its mesh is linked from another file.
    """
    require_own(mesh_of(obj))
    if not obj.visible_get():
        raise HeadError("{name} is hidden. Show it first.", name=obj.name)
    name = REGION_GROUPS[region]
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    obj.vertex_groups.active_index = group.index
    if context.object is not obj:  # the armature of the character, for instance, may be active and in Pose Mode
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        select_alone(context, obj)
    if context.mode != "PAINT_WEIGHT":
        bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
    _ensure_brush(context)


def _ensure_brush(context: bpy.types.Context) -> None:
    """Make sure that a weight paint brush is active, creating one if Blender has none."""
    paint = context.tool_settings.weight_paint
    assert paint is not None
    if paint.brush is not None:
        return
    if bpy.app.version < (4, 3, 0):
        brush = bpy.data.brushes.get("Draw") or bpy.data.brushes.new("Draw", mode="WEIGHT_PAINT")
        paint.brush = brush  # type: ignore[misc]  # read-only since Blender 4.3
        return
    brush = bpy.data.brushes.get(_BRUSH) or bpy.data.brushes.new(_BRUSH, mode="WEIGHT_PAINT")
    brush.asset_mark()
    bpy.ops.brush.asset_activate(asset_library_type="LOCAL", relative_asset_identifier=f"Brush/{brush.name}")


def mirror_painted(obj: bpy.types.Object, source: Side) -> None:
    """Mirror the regions of the head's own left or right half to the other; raises HeadError if regions are missing."""
    mesh = mesh_of(obj)
    vertices, faces, landmarks = read_vertices(mesh), read_faces(mesh), read_landmarks(obj)
    write_regions(obj, mirror_regions(vertices, faces, landmarks, read_regions(obj), source))


def smooth_painted(obj: bpy.types.Object, repeat: int) -> None:
    """Smooth the regions' borders `repeat` times, except at landmarks; raises HeadError if regions are missing."""
    mesh = mesh_of(obj)
    vertices, landmarks, painted = read_vertices(mesh), read_landmarks(obj), read_regions(obj)
    smooth = smooth_regions(vertices, read_faces(mesh), painted, repeat)
    write_regions(obj, hold_landmarks(smooth, vertices, landmarks, own_weights(painted, landmarks) > _FULL))
