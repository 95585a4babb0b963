"""Viewport overlay while points of a face are marked: a small face shows which point comes next."""

from __future__ import annotations

from functools import lru_cache

import bpy
import numpy as np
from bpy_extras import view3d_utils
from numpy.typing import NDArray

from ..blender.heads.binding import read_marks
from ..blender.heads.placing import Placing, place_of_mark
from ..blender.messages import interface as _
from ..blender.viewports import free_box
from ..core.binding.bind import MARKS
from ..core.face.landmarks import EDGES, from_ibug
from ..core.heads.built_in import load_head
from ..operators.place_points import placing_on
from ..operators.preview_place import MARGIN
from ..operators.shared import subject
from .drawing import WHITE, dot, draw_lines, draw_text, draw_triangles
from .point_overlay import rimmed

_FACE = 150.0
"""Height of the small face, pixels."""
_MARKED, _ASKED, _EXPECTED = (0.95, 0.75, 0.1), (1.0, 0.35, 0.1), (1.0, 1.0, 1.0)
_LINE = (0.85, 0.85, 0.85, 0.9)
_DOT = 5.0


@lru_cache(maxsize=1)
def _outline() -> NDArray[np.float64]:
    """(66, 2) landmarks of the built-in head from the front, y up, with a height of 1 and its middle at the bottom."""
    head = load_head()
    flat = np.array(head.vertices[head.landmarks][:, :2], dtype=np.float64)
    if flat[from_ibug([8])[0], 1] > flat[from_ibug([27])[0], 1]:
        flat[:, 1] *= -1.0
    flat -= np.array([flat[:, 0].mean(), flat[:, 1].min()])
    return flat / flat[:, 1].max()


def _draw() -> None:
    context = bpy.context
    placing = placing_on(subject(context))
    if placing is None or not placing.asked or context.region is None:
        return
    scale = context.preferences.system.ui_scale
    _draw_marks(context, placing, scale)
    if placing.next_mark is not None:
        _draw_guide(context, placing, scale)


def _draw_marks(context: bpy.types.Context, placing: Placing, scale: float) -> None:
    """Draw the marks, and a light dot where the search expects the next one."""
    drawn = []
    for vertex in read_marks(placing.obj.data).values():
        if (pixel := _pixel(context, placing.obj, vertex)) is not None:
            drawn += rimmed(pixel, _DOT * scale, _MARKED, scale)
    expected = None if placing.next_mark is None else place_of_mark(placing.obj, placing.next_mark)
    if expected is not None and (pixel := _pixel(context, placing.obj, expected)) is not None:
        drawn += rimmed(pixel, 0.7 * _DOT * scale, _EXPECTED, scale)
    draw_triangles(drawn)


def _pixel(context: bpy.types.Context, obj: bpy.types.Object, vertex: int) -> NDArray[np.float64] | None:
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    if vertex >= len(evaluated.data.vertices):
        return None
    place = evaluated.matrix_world @ evaluated.data.vertices[vertex].co
    pixel = view3d_utils.location_3d_to_region_2d(context.region, context.region_data, place)
    return None if pixel is None else np.array(pixel)


def _draw_guide(context: bpy.types.Context, placing: Placing, scale: float) -> None:
    """Draw the small face, with the next point and its name."""
    size = _FACE * scale
    outline = size * _outline()
    free = free_box(context.area, context.region)
    corner = np.array([free.left, free.bottom]) + MARGIN * scale
    outline += corner + (np.ptp(outline[:, 0]) / 2.0, 0.0)
    draw_lines(outline[np.array(EDGES)], _LINE)
    asked = outline[from_ibug([placing.next_mark])[0]]
    marked = [outline[from_ibug([number])[0]] for number in placing.asked[: placing.step]]
    draw_triangles([dot(place, 0.6 * _DOT * scale, _MARKED) for place in marked])
    draw_triangles(rimmed(asked, _DOT * scale, _ASKED, scale))
    name = _(MARKS[placing.next_mark].capitalize())
    number, count = placing.step + 1, len(placing.asked)
    text = _("{number} of {count}: {name}").format(number=number, count=count, name=name)
    draw_text(text, (corner[0], corner[1] + size + 12 * scale), 14 * scale, WHITE)


OVERLAYS = {_draw: "POST_PIXEL"}
