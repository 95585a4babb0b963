"""3D viewports of a window: which one is under the mouse, and drawing them again."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import bpy


class Viewport(NamedTuple):
    """The main region of a 3D viewport, and how it looks at the scene."""

    region: bpy.types.Region
    view: bpy.types.RegionView3D


def viewports(screen: bpy.types.Screen | None) -> Iterator[Viewport]:
    """The 3D viewports of a screen; none where there is no screen."""
    for area in () if screen is None else screen.areas:
        if area.type == "VIEW_3D":
            region = next(region for region in area.regions if region.type == "WINDOW")
            yield Viewport(region, area.spaces.active.region_3d)


def viewport_under(context: bpy.types.Context, x: int, y: int) -> Viewport | None:
    """The viewport at a place (x, y) of the window, pixels from its lower left; None where there is something else."""
    for viewport in viewports(context.screen):
        region = viewport.region
        if 0 <= x - region.x < region.width and 0 <= y - region.y < region.height:
            return viewport
    return None


def redraw(context: bpy.types.Context, kind: str = "WINDOW") -> None:
    """Draw the 3D viewports of all windows again, "WINDOW", or their sidebars, "UI"."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == kind:
                        region.tag_redraw()
