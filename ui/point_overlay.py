"""Viewport overlay of the landmarks as dots, with control points in the colours of their regions."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender.heads.landmark_places import landmark_places
from ..blender.meshes import is_head
from ..core.control_points.table import REGION_COLOURS, PointRow
from ..core.errors import FacemimeError
from .control_points import shown_rows

_CORNERS = 12
_ANGLES = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_RADIUS, _SMALL_RADIUS, _RIM = 4.5, 2.5, 1.5
_GREY, _SELECTED_COLOUR, _RIM_COLOUR = (0.6, 0.6, 0.6), (1.0, 1.0, 1.0), (0.05, 0.05, 0.05)


class _Overlay:
    """The draw handler."""

    handle: object = None


def _draw() -> None:
    context = bpy.context
    obj, steps = context.active_object, context.scene.facemime_steps
    if not steps.show_points or obj is None or not is_head(obj) or not obj.visible_get():
        return
    if not context.space_data.overlay.show_overlays or context.mode == "EDIT_MESH":
        return
    region, view = context.region, np.array(context.region_data.perspective_matrix)
    try:
        rows = shown_rows(obj)
        places = landmark_places(obj, context.evaluated_depsgraph_get(), view, (region.width, region.height))
    except FacemimeError:  # the panels show what is wrong with the head or its control points
        return
    triangles, colours = dots(rows, places.pixels, places.facing, steps.landmark, context.preferences.system.ui_scale)
    _draw_triangles(triangles, colours)


def dots(
    rows: list[PointRow], pixels: NDArray[np.float64], facing: NDArray[np.bool_], selected: int, scale: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Triangulate a dot with a dark rim for each landmark that faces the viewer.

    Parameters
    ----------
    rows : list of PointRow
        One per landmark.
    pixels : (66, 2) array
        Positions in the region, pixels.
    facing : (66,) array of bool
        Whether the skin at a landmark faces the viewer.
    selected : int
        The landmark to highlight; -1 for none.
    scale : float
        Resolution scale of the interface.

    Returns
    -------
    corners : (3 T, 2) float32
        Corners of the triangles, pixels.
    colours : (3 T, 4) float32
        RGBA colour of each corner.
    """
    corners, colours = [], []
    for row in rows:
        if not facing[row.landmark]:
            continue
        radius = _RADIUS if row.regions else _SMALL_RADIUS
        colour = REGION_COLOURS[row.regions[0]] if row.regions else _GREY
        if row.landmark == selected:
            radius, colour = 1.6 * _RADIUS, _SELECTED_COLOUR
        for size, paint in ((radius + _RIM, _RIM_COLOUR), (radius, colour)):
            circle = pixels[row.landmark] + size * scale * _CIRCLE
            fan = np.stack([np.broadcast_to(circle[:1], circle.shape), circle, np.roll(circle, -1, axis=0)], axis=1)
            corners.append(fan.reshape(-1, 2))
            colours.append(np.tile((*paint, 1.0), (3 * _CORNERS, 1)))
    if not corners:
        return np.zeros((0, 2), np.float32), np.zeros((0, 4), np.float32)
    return np.concatenate(corners).astype(np.float32), np.concatenate(colours).astype(np.float32)


def _draw_triangles(corners: NDArray[np.float32], colours: NDArray[np.float32]) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    if len(corners) == 0:
        return
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    flat = np.pad(corners, ((0, 0), (0, 1)))
    gpu.state.blend_set("ALPHA")
    batch_for_shader(shader, "TRIS", {"pos": flat, "color": colours}).draw(shader)
    gpu.state.blend_set("NONE")


def register() -> None:
    """Add the draw handler to all 3D Viewports."""
    _Overlay.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Remove the draw handler."""
    bpy.types.SpaceView3D.draw_handler_remove(_Overlay.handle, "WINDOW")
    _Overlay.handle = None
