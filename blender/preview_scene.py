"""A scene that shows a head at its best in a fraction of a second: Workbench, even light, shaded folds."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

_LENS = 85.0
_MARGIN = 1.02
_STUDIO_LIGHT = "paint.sl"
_FOLD_SHARE = 0.05
"""Folds of this share of the head's extent are shaded; without it an even light hides what a face does."""

_BACKGROUND = (0.16, 0.17, 0.19)


def setup_preview(scene: bpy.types.Scene, head_object: bpy.types.Object, size: tuple[int, int] = (512, 512)) -> None:
    """Point a camera of `scene` at the front of `head_object`, any mesh, and set Workbench up for `size` pixels."""
    low, high = _bounds(head_object)
    _aim_camera(scene, low, high, size)
    render = scene.render
    render.engine = "BLENDER_WORKBENCH"
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = 100
    render.film_transparent = False
    scene.view_settings.view_transform = "Standard"
    if scene.world is None:
        scene.world = bpy.data.worlds.new("Facemime Preview")
    scene.world.color = _BACKGROUND
    _set_shading(scene, float(np.max(high - low)))


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


def _bounds(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest corner of the object's bounding box in world space."""
    bpy.context.view_layer.update()
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    return corners.min(axis=0), corners.max(axis=0)


def _aim_camera(scene: bpy.types.Scene, low: np.ndarray, high: np.ndarray, size: tuple[int, int]) -> None:
    data = bpy.data.cameras.new("Facemime Preview")
    camera = bpy.data.objects.new("Facemime Preview", data)
    scene.collection.objects.link(camera)
    data.lens, data.sensor_width, data.sensor_fit = _LENS, 36.0, "HORIZONTAL"
    width, _, height = (high - low) * _MARGIN
    across = max(width, height * size[0] / size[1])
    centre = (low + high) / 2.0
    distance = across * _LENS / data.sensor_width
    camera.location = (centre[0], low[1] - distance, centre[2])
    camera.rotation_euler = (np.pi / 2.0, 0.0, 0.0)
    data.clip_start, data.clip_end = distance / 100.0, distance * 10.0
    scene.camera = camera
