"""The regions' colours over the head in the viewport; nothing is done, and nothing costs, where they are not shown.

What is drawn is the mesh as Blender shows it, moved and with its modifiers. Its triangles and weights are kept until
the mesh is changed; only places are read for every drawing.
"""

from __future__ import annotations

from time import perf_counter

import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Matrix

from ..blender.meshes import is_head, read_regions
from ..core.control_points.table import region_colours
from ..core.errors import HeadError
from ..operators.puppet import running

_TOWARDS_VIEWER = 0.002
"""How far the colours lie before the skin, of the head's size."""
_DEAR, _PATIENCE = 0.02, 1.0
"""Seconds: reading weights that took longer than the first is not done again before the second has passed."""


class _Kept:
    """What was read from the mesh, and the handler that draws."""

    handle: object = None
    key: tuple = ()
    stale = True
    triangles: np.ndarray
    colours: np.ndarray
    batch_parts: tuple = ()
    read_at = 0.0
    took = 0.0


def shown_regions(context: bpy.types.Context) -> bpy.types.Object | None:
    """The head whose regions are to be drawn; None where none is."""
    obj = context.active_object
    if not context.scene.facemime_steps.show_regions or obj is None or not is_head(obj) or not obj.visible_get():
        return None
    if context.mode in ("PAINT_WEIGHT", "EDIT_MESH"):
        _Kept.stale = True
        return None
    return obj


def coloured_triangles(obj: bpy.types.Object, opacity: float) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) int32 triangles that lie in any region and (V, 4) colours of an evaluated head.

    Raises
    ------
    HeadError
        Where it has no regions.
    """
    mesh = obj.data
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    triangles = triangles.reshape(-1, 3)
    colours = region_colours(read_regions(obj), opacity)
    return triangles[colours[triangles, 3].any(axis=1)], colours


def _draw() -> None:
    context = bpy.context
    obj = shown_regions(context)
    if obj is None or not context.space_data.overlay.show_overlays:
        return
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    try:
        _renew(evaluated, context.scene.facemime_steps.regions_opacity)
    except HeadError:  # the panels Head and Regions say what is missing
        return
    _draw_triangles(evaluated, context.region_data.view_matrix.inverted().col[2].to_3d())


def _renew(obj: bpy.types.Object, opacity: float) -> None:
    """Read the mesh again where it was changed, but not all the time where that is dear."""
    key = (obj.session_uid, len(obj.data.vertices), len(obj.data.polygons), opacity)
    now = perf_counter()
    fresh = not _Kept.stale or (_Kept.took > _DEAR and now - _Kept.read_at < _PATIENCE)
    if key == _Kept.key and fresh:
        return
    _Kept.key = ()
    _Kept.triangles, _Kept.colours = coloured_triangles(obj, opacity)
    _Kept.batch_parts = ()
    _Kept.key, _Kept.stale, _Kept.read_at = key, False, perf_counter()
    _Kept.took = _Kept.read_at - now


def _draw_triangles(obj: bpy.types.Object, to_viewer) -> None:
    import gpu

    if not _Kept.batch_parts:
        colours = _buffer(gpu, "color", 4, _Kept.colours)
        _Kept.batch_parts = (colours, gpu.types.GPUIndexBuf(type="TRIS", seq=_Kept.triangles))
    colours, triangles = _Kept.batch_parts
    places = np.empty(3 * len(obj.data.vertices), dtype=np.float32)
    obj.data.attributes["position"].data.foreach_get("vector", places)
    batch = gpu.types.GPUBatch(type="TRIS", buf=_buffer(gpu, "pos", 3, places.reshape(-1, 3)), elem=triangles)
    batch.vertbuf_add(colours)
    before = Matrix.Translation(to_viewer * max(obj.dimensions) * _TOWARDS_VIEWER)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(before @ obj.matrix_world)
        batch.draw(gpu.shader.from_builtin("SMOOTH_COLOR"))
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _buffer(gpu, name: str, length: int, values: np.ndarray):
    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id=name, comp_type="F32", len=length, fetch_mode="FLOAT")
    buffer = gpu.types.GPUVertBuf(layout, len(values))
    buffer.attr_fill(name, np.ascontiguousarray(values, dtype=np.float32))
    return buffer


@persistent
def _on_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Weights may have changed where a mesh has; a puppet and playing animation move vertices only."""
    if _Kept.stale or not scene.facemime_steps.show_regions or running() is not None:
        return
    if any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows):
        return
    _Kept.stale = any(update.is_updated_geometry for update in depsgraph.updates)


HANDLERS = {"depsgraph_update_post": _on_update}


def register() -> None:
    """Draw in every 3D viewport."""
    _Kept.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    """Stop drawing."""
    bpy.types.SpaceView3D.draw_handler_remove(_Kept.handle, "WINDOW")
    _Kept.handle, _Kept.key, _Kept.batch_parts = None, (), ()
