"""Position and size of the preview in a viewport, and how the mouse changes them."""

from __future__ import annotations

from typing import NamedTuple

import bpy

from ..blender.viewports import Viewport, free_box, largest_viewport, redraw, viewport_under
from ..sessions.live import LiveSession
from ..settings.preferences import FacemimePreferences, preferences

MARGIN = 16.0
_GRIP = 18.0
"""Pixels from the preview's upper right corner within which dragging changes its size."""
_SIZES = (80, 640)


class Box(NamedTuple):
    """A rectangle in a viewport, pixels from the lower left corner of its region."""

    left: float
    bottom: float
    width: float
    height: float


def preview_box(area: bpy.types.Area, region: bpy.types.Region, picture: tuple[int, int]) -> Box:
    """Return where the preview is drawn: where the user placed it, or in the lower left corner.

    It is always in view, clear of what covers the viewport, and at most a quarter of the rest. `picture` is the height
    and width of the picture in pixels.
    """
    user, scale = preferences(), bpy.context.preferences.system.ui_scale
    free, aspect = free_box(area, region), picture[0] / picture[1]
    width = min(user.preview_size * scale, (free.right - free.left) / 2, (free.top - free.bottom) / 2 / aspect)
    height = width * aspect
    left = free.left + (MARGIN + user.preview_place[0]) * scale
    bottom = free.bottom + (MARGIN + user.preview_place[1]) * scale
    return Box(
        max(free.left, min(left, free.right - width)), max(free.bottom, min(bottom, free.top - height)), width, height
    )


def has_preview(screen: bpy.types.Screen, region: bpy.types.Region) -> bool:
    """Return whether the preview is in this region.

    It is in the largest 3D Viewport of the screen, or the view of its Quad View of which least is covered.
    """
    largest = largest_viewport(screen)
    if largest is None:
        return False
    views = [other for other in reversed(largest.area.regions) if other.type == "WINDOW"]
    return bool(max(views, key=lambda view: _free_space(largest.area, view)) == region)


def _free_space(area: bpy.types.Area, region: bpy.types.Region) -> float:
    free = free_box(area, region)
    return (free.right - free.left) * (free.top - free.bottom)


class PreviewDrag:
    """Moves the preview when its middle is dragged, and resizes it when its upper right corner is dragged."""

    def __init__(self) -> None:
        self._from: tuple[int, int] | None = None
        self._sizes = False
        self._before: tuple[float, ...] = ()

    def handle(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        """Handle an event, and return whether it was for the preview."""
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            return self._grip(context, event)
        if self._from is None:
            return False
        if event.type == "MOUSEMOVE":
            self._drag(preferences(), event, self._from)
            redraw(context)
            return True
        if event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self._from = None
            return True
        return False

    def _grip(self, context: bpy.types.Context, event: bpy.types.Event) -> bool:
        seen, session = viewport_under(context, event.mouse_x, event.mouse_y), LiveSession.running()
        if seen is None or session is None or session.shown is None or session.shown.preview is None:
            return False
        if context.screen is None or not has_preview(context.screen, seen.region):
            return False
        height, width = session.shown.preview.shape[:2]
        box = preview_box(seen.area, seen.region, (height, width))
        right, up = event.mouse_x - seen.region.x - box.left, event.mouse_y - seen.region.y - box.bottom
        if not (0.0 <= right < box.width and 0.0 <= up < box.height) or _over_sidebar(seen, event):
            return False
        user, reach = preferences(), _GRIP * context.preferences.system.ui_scale
        self._sizes = right > box.width - reach and up > box.height - reach
        self._from = (event.mouse_x, event.mouse_y)
        self._before = (float(user.preview_size),) if self._sizes else tuple(user.preview_place)
        return True

    def _drag(self, user: FacemimePreferences, event: bpy.types.Event, start: tuple[int, int]) -> None:
        scale = bpy.context.preferences.system.ui_scale
        right, up = (event.mouse_x - start[0]) / scale, (event.mouse_y - start[1]) / scale
        if self._sizes:
            user.preview_size = round(min(max(self._before[0] + right, _SIZES[0]), _SIZES[1]))
        else:
            user.preview_place = (self._before[0] + right, self._before[1] + up)


def _over_sidebar(seen: Viewport, event: bpy.types.Event) -> bool:
    """Return whether another region, such as the sidebar, is over the viewport there."""
    return any(
        0 <= event.mouse_x - region.x < region.width and 0 <= event.mouse_y - region.y < region.height
        for region in seen.area.regions
        if region.width > 1 and region.type in {"UI", "TOOLS", "HUD"}
    )
