"""Viewport overlay of the regions' colours.

The evaluated mesh is drawn, with its modifiers and transform. Triangles and weights are cached until the mesh changes;
only positions are read for every redraw.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..blender.meshes import is_head, mesh_of, read_regions
from ..blender.viewports import shows_overlays, viewport_drawn
from ..core.control_points.table import region_colours
from ..core.errors import HeadError
from ..operators.puppet import running
from ..operators.shared import subject

_TOWARDS_VIEWER = 0.002
"""Distance of the overlay from the skin, relative to the size of the head."""
_SLOW = 0.02
"""Seconds above which reading the weights counts as slow."""
_PAUSE = 1.0
"""Seconds until they are read again if that is slow."""


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
    """Return the triangles of an evaluated head that lie in any region, and the colours of its vertices.

    Parameters
    ----------
    obj : bpy.types.Object
        Evaluated head with V vertices.
    opacity : float
        Alpha of the colours at full weight.

    Returns
    -------
    triangles : (T, 3) int32
    colours : (V, 4) float32

    Raises
    ------
    HeadError
        If it has no regions.
    """
    mesh = mesh_of(obj)
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    triangles = triangles.reshape(-1, 3)
    colours = region_colours(read_regions(obj), opacity)
    return triangles[colours[triangles, 3].any(axis=1)], colours


def _draw() -> None:
    context = bpy.context
    obj = shown_regions(context)
    seen = viewport_drawn(context)
    if obj is None or seen is None or not shows_overlays(context):
        return
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
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


HANDLERS = {"depsgraph_update_post": _on_update}
OVERLAYS = {_draw: "POST_VIEW"}


def unregister() -> None:
    """Free what was read."""
    _Cache.key, _Cache.batch_parts = (), ()
