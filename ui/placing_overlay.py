"""Viewport overlay while points of a face are marked: a small face shows which point comes next."""

from __future__ import annotations

from functools import lru_cache

import bpy
import numpy as np
from bpy_extras import view3d_utils
from numpy.typing import NDArray

from ..blender.heads.binding import read_marks
from ..blender.heads.placing import Placing, place_of_mark
from ..blender.meshes import mesh_of, object_of
from ..blender.messages import interface as _
from ..blender.viewports import Viewport, free_box, viewport_drawn
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
_MARKED = (0.95, 0.75, 0.1)
"""Colour of the marks, RGB."""
_ASKED = (1.0, 0.35, 0.1)
"""Colour of the next point on the small face, RGB."""
_EXPECTED = (1.0, 1.0, 1.0)
"""Colour of the place where the next mark is expected, RGB."""
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
    return np.asarray(flat / flat[:, 1].max())


def _draw() -> None:
    context = bpy.context
    placing = placing_on(subject(context))
    seen = viewport_drawn(context)
    if placing is None or not placing.asked or seen is None:
        return
    scale = context.preferences.system.ui_scale
    _draw_marks(context, seen, placing, scale)
    if placing.next_mark is not None:
        _draw_guide(seen, placing, placing.next_mark, scale)


def _draw_marks(context: bpy.types.Context, seen: Viewport, placing: Placing, scale: float) -> None:
    """Draw the marks, and a light dot where the search expects the next one."""
    drawn = []
    obj = object_of(placing.obj)
    for vertex in read_marks(mesh_of(obj)).values():
        if (pixel := _pixel(context, seen, obj, vertex)) is not None:
            drawn += rimmed(pixel, _DOT * scale, _MARKED, scale)
    expected = None if placing.next_mark is None else place_of_mark(obj, placing.next_mark)
    if expected is not None and (pixel := _pixel(context, seen, obj, expected)) is not None:
        drawn += rimmed(pixel, 0.7 * _DOT * scale, _EXPECTED, scale)
    draw_triangles(drawn)


def _pixel(
    context: bpy.types.Context, seen: Viewport, obj: bpy.types.Object, vertex: int
) -> NDArray[np.float64] | None:
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    if vertex >= len(mesh_of(evaluated).vertices):
        return None
    place = evaluated.matrix_world @ mesh_of(evaluated).vertices[vertex].co
    pixel = view3d_utils.location_3d_to_region_2d(seen.region, seen.view, place)
    return None if pixel is None else np.array(pixel)


def _draw_guide(seen: Viewport, placing: Placing, next_mark: int, scale: float) -> None:
    """Draw the small face, with the next point and its name."""
    size = _FACE * scale
    outline = size * _outline()
    free = free_box(seen.area, seen.region)
    corner = np.array([free.left, free.bottom]) + MARGIN * scale
    outline += corner + (np.ptp(outline[:, 0]) / 2.0, 0.0)
    draw_lines(outline[np.array(EDGES)], _LINE)
    asked = outline[from_ibug([next_mark])[0]]
    marked = [outline[from_ibug([number])[0]] for number in placing.asked[: placing.step]]
    draw_triangles([dot(place, 0.6 * _DOT * scale, _MARKED) for place in marked])
    draw_triangles(rimmed(asked, _DOT * scale, _ASKED, scale))
    name = _(MARKS[next_mark])
    number, count = placing.step + 1, len(placing.asked)
    text = _("{number} of {count}: {name}").format(number=number, count=count, name=name)
    draw_text(text, (corner[0], corner[1] + size + 12 * scale), 14 * scale, WHITE)


OVERLAYS = {_draw: "POST_PIXEL"}
