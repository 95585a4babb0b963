"""Scene for fast renders of a head: Workbench with even light and shaded folds."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

_LENS, _SENSOR = 85.0, 36.0
_MARGIN = 1.08
_STUDIO_LIGHT = "paint.sl"
_FOLD_SHARE = 0.05
"""Size of the folds that are shaded, relative to the head; even light alone would hide the motion of a face."""

_BACKGROUND = (0.16, 0.17, 0.19)


def setup_preview(scene: bpy.types.Scene, head_object: bpy.types.Object, size: tuple[int, int] = (512, 512)) -> None:
    """Set up a camera in front of a head, and Workbench.

    Parameters
    ----------
    scene : bpy.types.Scene
    head_object : bpy.types.Object
        Any mesh.
    size : (int, int)
        Width and height of the render, pixels.
    """
    points = _vertices(head_object)
    _aim_camera(scene, points, size)
    render = scene.render
    render.engine = "BLENDER_WORKBENCH"
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = 100
    render.film_transparent = False
    scene.view_settings.view_transform = "Standard"
    if scene.world is None:
        scene.world = bpy.data.worlds.new("Facemime Preview")
    scene.world.color = _BACKGROUND
    _set_shading(scene, float(np.ptp(points, axis=0).max()))


def _set_shading(scene: bpy.types.Scene, extent: float) -> None:
    scene.display.render_aa = "8"
    shading = scene.display.shading
    shading.light = "STUDIO"
    shading.studio_light = _STUDIO_LIGHT
    shading.color_type = "TEXTURE"
    shading.show_cavity = True
    shading.cavity_type = "WORLD"
    shading.cavity_valley_factor, shading.cavity_ridge_factor = 1.6, 0.0
    scene.display.matcap_ssao_distance = extent * _FOLD_SHARE
    shading.show_shadows = False
    shading.show_object_outline = False
    shading.show_specular_highlight = True


def _vertices(obj: bpy.types.Object) -> NDArray[np.float64]:
    """Return (V, 3) vertices at rest of the mesh `obj` in world space."""
    bpy.context.view_layer.update()
    flat = np.empty(3 * len(obj.data.vertices), dtype=np.float32)
    obj.data.vertices.foreach_get("co", flat)
    world = np.array(obj.matrix_world)
    return np.asarray(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])


def _aim_camera(scene: bpy.types.Scene, points: NDArray[np.float64], size: tuple[int, int]) -> None:
    """Add a camera straight in front of the points, as near as possible with all of them and a margin in view."""
    data = bpy.data.cameras.new("Facemime Preview")
    camera = bpy.data.objects.new("Facemime Preview", data)
    scene.collection.objects.link(camera)
    data.lens, data.sensor_width, data.sensor_fit = _LENS, _SENSOR, "HORIZONTAL"
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2.0
    across = _SENSOR / (2.0 * _LENS * _MARGIN)
    upwards = across * size[1] / size[0]
    beside = np.abs(points - centre)
    nearest = (points[:, 1] - np.maximum(beside[:, 0] / across, beside[:, 2] / upwards)).min()
    distance = centre[1] - nearest
    camera.location = (centre[0], nearest, centre[2])
    camera.rotation_euler = (np.pi / 2.0, 0.0, 0.0)
    data.clip_start, data.clip_end = distance / 100.0, distance * 10.0
    scene.camera = camera
