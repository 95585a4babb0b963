"""3D Viewports: find the one under the mouse, and redraw them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

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
    """Yield the 3D Viewports of a screen; none if there is no screen."""
    for area in () if screen is None else screen.areas:
        if area.type == "VIEW_3D":
            region = next(region for region in area.regions if region.type == "WINDOW")
            yield Viewport(region, area.spaces.active.region_3d, area)


def viewport_under(context: bpy.types.Context, x: int, y: int) -> Viewport | None:
    """Find the 3D Viewport at a position in the window.

    Parameters
    ----------
    context : bpy.types.Context
    x, y : int
        Pixels from the lower left corner of the window.

    Returns
    -------
    Viewport or None
        None if another editor or region is there.
    """
    for viewport in viewports(context.screen):
        region = viewport.region
        if 0 <= x - region.x < region.width and 0 <= y - region.y < region.height:
            return viewport
    return None


def viewport_of(context: bpy.types.Context) -> Viewport | None:
    """Return the 3D Viewport that is in use, otherwise the largest one of the window; None without any."""
    here = [viewport for viewport in viewports(context.screen) if viewport.area == context.area]
    return here[0] if here else largest_viewport(context.screen)


def largest_viewport(screen: bpy.types.Screen | None) -> Viewport | None:
    """Return the largest 3D Viewport of a screen; None without any."""
    return max(viewports(screen), key=lambda viewport: viewport.region.width * viewport.region.height, default=None)


def redraw(context: bpy.types.Context, kind: str = "WINDOW") -> None:
    """Redraw the 3D Viewports of all windows (`kind` "WINDOW") or their sidebars ("UI").

    Parameters
    ----------
    context : bpy.types.Context
        The context.
    kind : str
        Type of the areas.
    """
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == kind:
                        region.tag_redraw()


def is_hidden_by_others(
    context: bpy.types.Context, seen: Viewport, points: NDArray[np.floating], own: Collection[bpy.types.Object]
) -> bool:
    """Return whether most of some points are behind other objects.

    Parameters
    ----------
    context : bpy.types.Context
    seen : Viewport
        Orthographic.
    points : (N, 3) array
        Points of a surface in the world.
    own : collection of bpy.types.Object
        The objects that may be in front of them.
    """
    towards = seen.view.view_rotation @ Vector((0.0, 0.0, 1.0))
    step = 1e-3 * float(np.ptp(points, axis=0).max())
    graph = context.evaluated_depsgraph_get()
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


def show_alone(context: bpy.types.Context, own: Collection[bpy.types.Object]) -> None:
    """Show some objects and the lights in the Local View of the viewport in use; one of them has to be selected.

    Parameters
    ----------
    context : bpy.types.Context
    own : collection of bpy.types.Object
    """
    bpy.ops.view3d.localview(frame_selected=False)
    for obj in context.view_layer.objects:
        obj.local_view_set(context.space_data, obj in own or obj.type in _LIGHTS)


def toolbar_width(area: bpy.types.Area) -> float:
    """Return how much of a viewport the toolbar covers on the left, pixels."""
    return _covered(area, "LEFT", {"TOOLS"})


def visible_span(area: bpy.types.Area, region: bpy.types.Region) -> tuple[float, float]:
    """Return the left and right ends of the part of a viewport that the toolbar and Sidebar do not cover, pixels.

    Parameters
    ----------
    area : bpy.types.Area
    region : bpy.types.Region
        Its main region.
    """
    left, right = (_covered(area, side, {"TOOLS", "UI"}) for side in ("LEFT", "RIGHT"))
    return left, max(region.width - right, left)


def _covered(area: bpy.types.Area, side: str, kinds: set[str]) -> float:
    """Return the width of the regions of these kinds that lie over the viewport on one side."""
    if not bpy.context.preferences.system.use_region_overlap:
        return 0.0
    over = [region for region in area.regions if region.type in kinds and region.alignment == side]
    return float(sum(region.width for region in over if region.width > 1))


def redo_height(area: bpy.types.Area) -> float:
    """Return how much of a viewport the panel of the last operator covers below, pixels."""
    return float(max((region.height for region in area.regions if region.type == "HUD"), default=0.0))
