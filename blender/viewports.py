"""3D Viewports: find the one under the mouse, and redraw them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

from .contexts import evaluated_depsgraph

_HITS = 16
"""Maximum number of surfaces of a character that a line of sight passes through."""
_OPAQUE = {"TEXTURED", "SOLID"}
_LIGHTS = {"LIGHT", "LIGHT_PROBE"}


class Viewport(NamedTuple):
    """The main region of a 3D Viewport, its view of the scene, and its area."""

    region: bpy.types.Region
    view: bpy.types.RegionView3D
    area: bpy.types.Area


def viewports(screen: bpy.types.Screen | None) -> Iterator[Viewport]:
    """Yield the 3D Viewports of a screen, each view of a Quad View by itself; none if there is no screen."""
    for area in () if screen is None else screen.areas:
        if area.type == "VIEW_3D":
            for region in area.regions:
                if region.type == "WINDOW" and isinstance(region.data, bpy.types.RegionView3D):
                    yield Viewport(region, region.data, area)


def viewport_under(context: bpy.types.Context, x: int, y: int) -> Viewport | None:
    """Find the 3D Viewport at a pixel from the lower left corner of the window; None if another region is there."""
    for viewport in viewports(context.screen):
        region = viewport.region
        if 0 <= x - region.x < region.width and 0 <= y - region.y < region.height:
            return viewport
    return None


def viewport_of(context: bpy.types.Context) -> Viewport | None:
    """Return the 3D Viewport that is in use, otherwise the largest one of the window; None without any."""
    here = [viewport for viewport in viewports(context.screen) if viewport.area == context.area]
    return here[-1] if here else largest_viewport(context.screen)


def largest_viewport(screen: bpy.types.Screen | None) -> Viewport | None:
    """Return the largest 3D Viewport of a screen, in Quad View that of the user's perspective; None without any."""
    size = {viewport.area: viewport.area.width * viewport.area.height for viewport in viewports(screen)}
    largest = max(size, key=lambda area: size[area], default=None)
    return next((viewport for viewport in reversed(list(viewports(screen))) if viewport.area == largest), None)


def redraw(context: bpy.types.Context, kind: str = "WINDOW") -> None:
    """Redraw the 3D Viewports of all windows (`kind` "WINDOW") or their sidebars ("UI")."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == kind:
                        region.tag_redraw()


def is_hidden_by_others(
    context: bpy.types.Context, seen: Viewport, points: NDArray[np.floating[Any]], own: Collection[bpy.types.Object]
) -> bool:
    """Return whether most points (N, 3) of a surface in the world are behind objects other than `own`."""
    towards = seen.view.view_rotation @ Vector((0.0, 0.0, 1.0))
    step = 1e-3 * float(np.ptp(points, axis=0).max())
    graph = evaluated_depsgraph(context)
    hidden = 0
    for point in points:
        start = Vector(point) + step * towards
        for _ in range(_HITS):
            hit, place, _, _, obj, _ = context.scene.ray_cast(graph, start, towards)
            if not hit:
                break
            if obj.original not in own and obj.display_type in _OPAQUE:
                hidden += 1
                break
            start = place + step * towards
    return 2 * hidden > len(points)


def viewport_drawn(context: bpy.types.Context) -> Viewport | None:
    """Return the viewport of the context, in which an overlay is being drawn; None if it is another editor."""
    area, region, view = context.area, context.region, context.region_data
    return None if area is None or region is None or view is None else Viewport(region, view, area)


def shows_overlays(context: bpy.types.Context) -> bool:
    """Return whether the context is a 3D Viewport whose overlays are enabled."""
    space = context.space_data
    return isinstance(space, bpy.types.SpaceView3D) and space.overlay.show_overlays


def show_alone(context: bpy.types.Context, own: Collection[bpy.types.Object]) -> None:
    """Show some objects and the lights in the Local View of the viewport in use; one of them has to be selected."""
    bpy.ops.view3d.localview(frame_selected=False)
    assert isinstance(context.space_data, bpy.types.SpaceView3D)
    for obj in context.view_layer.objects:
        obj.local_view_set(context.space_data, obj in own or obj.type in _LIGHTS)


class FreeBox(NamedTuple):
    """Edges of the part of a viewport that no other region covers, pixels from the lower left corner of the region."""

    left: float
    bottom: float
    right: float
    top: float


_BELOW = {"HUD", "ASSET_SHELF", "ASSET_SHELF_HEADER"}
_ACROSS = _BELOW | {"HEADER", "TOOL_HEADER"}
"""Types of the regions that Blender draws over a viewport and that are as wide as it is."""
_BESIDE = {"TOOLS", "UI"}
"""Types of the regions that Blender draws over a viewport at its sides."""


def free_box(area: bpy.types.Area, region: bpy.types.Region) -> FreeBox:
    """Return the part of a viewport that toolbar, Sidebar, headers, asset shelf and redo panel do not cover.

    The region is the main one, or one of those of Quad View.
    """
    left, bottom, right, top = 0.0, 0.0, float(region.width), float(region.height)
    for other in area.regions:
        if other.type == "WINDOW" or min(other.width, other.height) <= 1 or not _overlap(other, region):
            continue
        if other.type in _ACROSS:
            if other.type in _BELOW or other.alignment == "BOTTOM":
                bottom = max(bottom, other.y + other.height - region.y)
            else:
                top = min(top, other.y - region.y)
        elif other.type in _BESIDE:
            if other.x + other.width / 2 < region.x + region.width / 2:
                left = max(left, other.x + other.width - region.x)
            else:
                right = min(right, other.x - region.x)
    return FreeBox(left, bottom, max(right, left), max(top, bottom))


def _overlap(a: bpy.types.Region, b: bpy.types.Region) -> bool:
    across = a.x < b.x + b.width and b.x < a.x + a.width
    return across and a.y < b.y + b.height and b.y < a.y + a.height
