"""Viewport overlay of what the controls of a rig do to the face."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender.contexts import evaluated_depsgraph
from ..blender.controls.display import drawn_arrows
from ..blender.controls.stored import has_controls
from ..blender.meshes import is_head
from ..blender.viewports import shows_overlays, viewport_drawn
from ..operators.shared import subject
from .drawing import draw_triangles

_COLOURS = ((1.0, 0.25, 0.3), (0.5, 0.85, 0.15), (0.25, 0.55, 1.0), (1.0, 0.75, 0.1))
"""Colours of the axes of a control, as Blender's gizmos have them, and of properties."""
_RIM = (0.05, 0.05, 0.05)
_WIDTH, _RIM_WIDTH, _TIP = 2.0, 1.2, 9.0
"""Width of a shaft, of the rim around it, and length of a tip, in unscaled pixels."""
_LEAST = 3.0
"""Length of an arrow below which it points at the viewer and is not drawn, in unscaled pixels."""


def _draw_controls() -> None:
    context = bpy.context
    head = subject(context)
    shown = context.scene.facemime_steps.arrows
    if shown == "NONE" or head is None or not is_head(head) or not head.visible_get():
        return
    seen = viewport_drawn(context)
    if seen is None or not shows_overlays(context) or context.mode == "EDIT_MESH" or not has_controls(head):
        return
    region, view = seen.region, np.array(seen.view.perspective_matrix)
    graph, size = evaluated_depsgraph(context), (region.width, region.height)
    arrows = drawn_arrows(head, graph, view, size, every=shown == "ALL")
    if arrows is not None:
        scale = context.preferences.system.ui_scale
        drawn = [
            part
            for ends, axis in zip(arrows.ends, arrows.axes.tolist(), strict=True)
            for part in arrow(ends, _COLOURS[axis], scale)
        ]
        draw_triangles(drawn)


def arrow(
    ends: NDArray[np.float64], colour: tuple[float, float, float], scale: float
) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Triangulate an arrow (2, 2) in pixels with a dark rim, as `drawing.dot` does; nothing if it is too short."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length < _LEAST * scale:
        return []
    along /= length
    rim = _RIM_WIDTH * scale
    outline = _shape(ends[0] - rim * along, ends[1] + 1.5 * rim * along, along, scale, rim)
    return [_coloured(outline, _RIM), _coloured(_shape(ends[0], ends[1], along, scale, 0.0), colour)]


def _shape(
    start: NDArray[np.float64], end: NDArray[np.float64], along: NDArray[np.float64], scale: float, more: float
) -> NDArray[np.float64]:
    """Corners of the triangles of a shaft and a tip, (9, 2)."""
    across = np.array([-along[1], along[0]])
    tip = min(_TIP * scale, 0.6 * float(np.linalg.norm(end - start)))
    neck, half, wide = end - tip * along, (_WIDTH * scale / 2.0 + more) * across, (0.45 * tip + more) * across
    corners = [start - half, start + half, neck + half, start - half, neck + half, neck - half]
    return np.array([*corners, neck - wide, neck + wide, end])


def _coloured(corners: NDArray[np.float64], colour: tuple[float, float, float]) -> tuple[NDArray[Any], NDArray[Any]]:
    rgba = np.tile(np.array((*colour, 1.0), dtype=np.float32), (len(corners), 1))
    return corners.astype(np.float32), rgba


OVERLAYS = {_draw_controls: "POST_PIXEL"}
