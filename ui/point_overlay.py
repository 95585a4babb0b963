"""Viewport overlay of the landmarks as dots, with control points in the colours of their regions."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender.heads.landmark_places import landmark_places
from ..blender.meshes import is_head
from ..blender.viewports import shows_overlays, viewport_drawn
from ..core.control_points.table import REGION_COLOURS, PointRow
from ..core.errors import FacemimeError
from ..operators.shared import subject
from .control_points import shown_rows
from .drawing import dot, draw_triangles

_RADIUS = 4.5
"""Radius of the dot of a control point, in unscaled pixels."""
_SMALL_RADIUS = 2.5
"""Radius of the dot of any other landmark, in unscaled pixels."""
_RIM = 1.5
"""Width of the rim of a dot, in unscaled pixels."""
_GREY = (0.6, 0.6, 0.6)
_SELECTED_COLOUR = (1.0, 1.0, 1.0)
_RIM_COLOUR = (0.05, 0.05, 0.05)


def _draw() -> None:
    context = bpy.context
    obj, steps = subject(context), context.scene.facemime_steps
    if not steps.show_points or obj is None or not is_head(obj) or not obj.visible_get():
        return
    seen = viewport_drawn(context)
    if seen is None or not shows_overlays(context) or context.mode == "EDIT_MESH":
        return
    region, view = seen.region, np.array(seen.view.perspective_matrix)
    try:
        rows = shown_rows(obj)
        places = landmark_places(obj, context.evaluated_depsgraph_get(), view, (region.width, region.height))
    except FacemimeError:  # the panels show what is wrong with the head or its control points
        return
    scale = context.preferences.system.ui_scale
    draw_triangles(dots(rows, places.pixels, places.facing, steps.landmark, scale))


def dots(
    rows: list[PointRow], pixels: NDArray[np.float64], facing: NDArray[np.bool_], selected: int, scale: float
) -> list[tuple[NDArray[Any], NDArray[Any]]]:
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
    list of (corners, colours)
        See `drawing.dot`.
    """
    drawn = []
    for row in rows:
        if not facing[row.landmark]:
            continue
        radius = _RADIUS if row.regions else _SMALL_RADIUS
        colour = REGION_COLOURS[row.regions[0]] if row.regions else _GREY
        if row.landmark == selected:
            radius, colour = 1.6 * _RADIUS, _SELECTED_COLOUR
        drawn += rimmed(pixels[row.landmark], radius * scale, colour, scale)
    return drawn


def rimmed(
    place: NDArray[np.float64], radius: float, colour: tuple[float, float, float], scale: float
) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Triangulate a dot with a dark rim.

    Parameters
    ----------
    place : (2,) array
    colour : (float, float, float)
        RGB.
    scale : float
        Resolution scale of the interface.
    """
    return [dot(place, radius + _RIM * scale, _RIM_COLOUR), dot(place, radius, colour)]


OVERLAYS = {_draw: "POST_PIXEL"}
