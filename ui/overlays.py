"""Viewport overlays of a face: its regions, its landmarks, and the point to place next while they are marked.

The regions are drawn on the evaluated mesh, with its modifiers and transform. Triangles and weights are cached until
the mesh changes; only positions are read for every redraw.
"""

from __future__ import annotations

from functools import lru_cache
from time import perf_counter
from typing import Any

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..blender.contexts import evaluated_depsgraph
from ..blender.heads.binding import read_marks
from ..blender.heads.placing import Placing, landmark_places, place_of_mark
from ..blender.meshes import is_head, mesh_of, object_of, read_regions
from ..blender.messages import interface as _
from ..blender.viewports import Viewport, free_box, shows_overlays, viewport_drawn
from ..core.control_points.table import REGION_COLOURS, PointRow, region_colours
from ..core.errors import FacemimeError, HeadError
from ..core.face.landmarks import EDGES, from_ibug
from ..core.heads.bind import MARKS
from ..core.heads.built_in import load_head
from ..operators.place_points import placing_on
from ..operators.preview_place import MARGIN
from ..operators.puppet import running
from ..operators.shared import subject
from .control_points import shown_rows
from .drawing import WHITE, dot, draw_lines, draw_text, draw_triangles

_TOWARDS_VIEWER = 0.002
"""Distance of the overlay from the skin, relative to the size of the head."""
_SLOW = 0.02
"""Seconds above which reading the weights counts as slow."""
_PAUSE = 1.0
"""Seconds until they are read again if that is slow."""
_RADIUS = 4.5
"""Radius of the dot of a control point, in unscaled pixels."""
_SMALL_RADIUS = 2.5
"""Radius of the dot of any other landmark, in unscaled pixels."""
_RIM = 1.5
"""Width of the rim of a dot, in unscaled pixels."""
_GREY = (0.6, 0.6, 0.6)
_SELECTED_COLOUR = (1.0, 1.0, 1.0)
_RIM_COLOUR = (0.05, 0.05, 0.05)
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


class _Cache:
    """The data read from the mesh."""

    key: tuple[float, ...] = ()
    stale = True
    triangles: NDArray[Any]
    colours: NDArray[Any]
    batch_parts: tuple[Any, ...] = ()
    read_at = 0.0
    took = 0.0


def shown_regions(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the head whose regions are to be drawn, or None."""
    obj = subject(context)
    if not context.scene.facemime_steps.show_regions or obj is None or not is_head(obj) or not obj.visible_get():
        return None
    if context.mode in ("PAINT_WEIGHT", "EDIT_MESH"):
        _Cache.stale = True
        return None
    return obj


def coloured_triangles(obj: bpy.types.Object, opacity: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the triangles (T, 3) of an evaluated head that lie in any region, and the colours (V, 4) of its vertices.

    The opacity is reached at full weight. Raises HeadError if the head has no regions.
    """
    mesh = mesh_of(obj)
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    triangles = triangles.reshape(-1, 3)
    colours = region_colours(read_regions(obj), opacity)
    return triangles[colours[triangles, 3].any(axis=1)], colours


def _draw_regions() -> None:
    context = bpy.context
    obj = shown_regions(context)
    seen = viewport_drawn(context)
    if obj is None or seen is None or not shows_overlays(context):
        return
    evaluated = obj.evaluated_get(evaluated_depsgraph(context))
    try:
        _refresh(evaluated, context.scene.facemime_steps.regions_opacity)
    except HeadError:  # the panels Head and Regions show what is missing
        return
    _draw_triangles(evaluated, seen.view.view_matrix.inverted().col[2].to_3d())


def _refresh(obj: bpy.types.Object, opacity: float) -> None:
    """Read the mesh again if it has changed, but less often if that is slow."""
    key = (obj.session_uid, len(mesh_of(obj).vertices), len(mesh_of(obj).polygons), opacity)
    now = perf_counter()
    fresh = not _Cache.stale or (_Cache.took > _SLOW and now - _Cache.read_at < _PAUSE)
    if key == _Cache.key and fresh:
        return
    _Cache.key = ()
    _Cache.triangles, _Cache.colours = coloured_triangles(obj, opacity)
    _Cache.batch_parts = ()
    _Cache.key, _Cache.stale, _Cache.read_at = key, False, perf_counter()
    _Cache.took = _Cache.read_at - now


def _draw_triangles(obj: bpy.types.Object, to_viewer: Vector) -> None:
    import gpu

    types: Any = gpu.types  # the stubs lack constructors
    if not _Cache.batch_parts:
        colours = _buffer(types, "color", 4, _Cache.colours)
        _Cache.batch_parts = (colours, types.GPUIndexBuf(type="TRIS", seq=_Cache.triangles))
    colours, triangles = _Cache.batch_parts
    places = np.empty(3 * len(mesh_of(obj).vertices), dtype=np.float32)
    mesh_of(obj).attributes["position"].data.foreach_get("vector", places)
    batch = types.GPUBatch(type="TRIS", buf=_buffer(types, "pos", 3, places.reshape(-1, 3)), elem=triangles)
    batch.vertbuf_add(colours)
    before = Matrix.Translation(to_viewer * max(obj.dimensions[:]) * _TOWARDS_VIEWER)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    with gpu.matrix.push_pop():  # type: ignore[attr-defined, func-returns-value]  # returns a context manager
        gpu.matrix.multiply_matrix(before @ obj.matrix_world)
        batch.draw(gpu.shader.from_builtin("SMOOTH_COLOR"))
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _buffer(types: Any, name: str, length: int, values: NDArray[Any]) -> Any:
    layout = types.GPUVertFormat()
    layout.attr_add(id=name, comp_type="F32", len=length, fetch_mode="FLOAT")
    buffer = types.GPUVertBuf(layout, len(values))
    buffer.attr_fill(name, np.ascontiguousarray(values, dtype=np.float32))
    return buffer


def _on_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Mark the cache as stale if a mesh has changed; a puppet and playback only move vertices."""
    if _Cache.stale or not scene.facemime_steps.show_regions or running() is not None:
        return
    if any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows):
        return
    _Cache.stale = any(update.is_updated_geometry for update in depsgraph.updates)


def unregister() -> None:
    """Free what was read."""
    _Cache.key, _Cache.batch_parts = (), ()


def _draw_landmarks() -> None:
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
        places = landmark_places(obj, evaluated_depsgraph(context), view, (region.width, region.height))
    except FacemimeError:  # the panels show what is wrong with the head or its control points
        return
    scale = context.preferences.system.ui_scale
    draw_triangles(dots(rows, places.pixels, places.facing, steps.landmark, scale))


def dots(
    rows: list[PointRow], pixels: NDArray[np.float64], facing: NDArray[np.bool_], selected: int, scale: float
) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Triangulate a dot with a dark rim for each landmark that faces the viewer, as `drawing.dot` does.

    There is a row per landmark, whose `pixels` (66, 2) are those of the region. The selected one, unless it is -1, is
    highlighted. `scale` is the resolution scale of the interface.
    """
    drawn = []
    for row in rows:
        if not facing[row.landmark]:
            continue
        radius = _RADIUS if row.regions else _SMALL_RADIUS
        colour = REGION_COLOURS[row.regions[0]] if row.regions else _GREY
        if row.landmark == selected:
            radius, colour = 1.6 * _RADIUS, _SELECTED_COLOUR
        drawn += _rimmed(pixels[row.landmark], radius * scale, colour, scale)
    return drawn


def _rimmed(
    place: NDArray[np.float64], radius: float, colour: tuple[float, float, float], scale: float
) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Triangulate a dot with a dark rim, at the resolution scale of the interface."""
    return [dot(place, radius + _RIM * scale, _RIM_COLOUR), dot(place, radius, colour)]


@lru_cache(maxsize=1)
def _outline() -> NDArray[np.float64]:
    """(66, 2) landmarks of the built-in head from the front, y up, with a height of 1 and its middle at the bottom."""
    head = load_head()
    flat = np.array(head.vertices[head.landmarks][:, :2], dtype=np.float64)
    if flat[from_ibug([8])[0], 1] > flat[from_ibug([27])[0], 1]:
        flat[:, 1] *= -1.0
    flat -= np.array([flat[:, 0].mean(), flat[:, 1].min()])
    return np.asarray(flat / flat[:, 1].max())


def _draw_next_point() -> None:
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
            drawn += _rimmed(pixel, _DOT * scale, _MARKED, scale)
    expected = None if placing.next_mark is None else place_of_mark(obj, placing.next_mark)
    if expected is not None and (pixel := _pixel(context, seen, obj, expected)) is not None:
        drawn += _rimmed(pixel, 0.7 * _DOT * scale, _EXPECTED, scale)
    draw_triangles(drawn)


def _pixel(
    context: bpy.types.Context, seen: Viewport, obj: bpy.types.Object, vertex: int
) -> NDArray[np.float64] | None:
    evaluated = obj.evaluated_get(evaluated_depsgraph(context))
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
    draw_triangles(_rimmed(asked, _DOT * scale, _ASKED, scale))
    name = _(MARKS[next_mark])
    number, count = placing.step + 1, len(placing.asked)
    text = _("{number} of {count}: {name}").format(number=number, count=count, name=name)
    draw_text(text, (corner[0], corner[1] + size + 12 * scale), 14 * scale, WHITE)


HANDLERS = {"depsgraph_update_post": _on_update}
OVERLAYS = {_draw_regions: "POST_VIEW", _draw_landmarks: "POST_PIXEL", _draw_next_point: "POST_PIXEL"}
