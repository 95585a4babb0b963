"""Scene for fast renders of a head: Workbench with even light and shaded folds."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..core.face.landmarks import outer_eye_distance
from ..core.face.rotation import fit_rotation
from ..core.heads.built_in import load_head
from ..core.numeric.arrays import FloatArray
from .characters import objects_of
from .contexts import evaluated_depsgraph
from .frames import to_blender
from .meshes import can_be_driven, mesh_of, read_places
from .muting import mute_paths
from .names import PART_PROPERTY
from .surfaces import show_colour_images
from .view_layers import collections_in, revealed

_LENS = 85.0
"""Focal length in millimetres."""
_SENSOR = 36.0
"""Width of the sensor in millimetres."""
_MARGIN = 1.08
_STUDIO_LIGHT = "paint.sl"
_FOLD_SHARE = 0.03
"""Size of the folds that are shaded, relative to the head; even light alone would hide the motion of a face. Lips shade
teeth near them with coarse noise if it is larger."""

_HEAD_REACH = 2.3
"""Distance from the middle of a head, in outer-eye distances, within which its points are in view."""
_NECK = 0.6
"""Distance below the chin, in outer-eye distances, down to which they are, if they are no farther aside than the face:
the shoulders and arms of a body need not be in view."""
_DEPTH = 0.5
"""Distance of that middle behind the landmarks, in outer-eye distances."""
_NEAR = 1.6
"""Distance of a viewport's eye from a head, relative to the head's size."""
_BACKGROUND = (0.16, 0.17, 0.19)


@dataclass(frozen=True)
class FaceView:
    """The part of a head that an image shows.

    Attributes
    ----------
    points : (N, 3) float64
        Points in the world that have to be in view.
    axes : (3, 3) float64
        Rotation of the face from upright towards -Y; its columns point to the viewer's right, away and up.
    """

    points: NDArray[np.float64]
    axes: NDArray[np.float64]


def face_view(obj: bpy.types.Object) -> FaceView:
    """Return the view of a head from the front of its face, as its armature poses it at the current frame.

    A mesh that is not bound is shown completely, from the front of the scene.
    """
    points = face_points(obj)
    if not can_be_driven(obj):
        return FaceView(points, np.eye(3))
    landmarks, head = read_places(obj), load_head()
    face = points[landmarks]
    known = to_blender(head.vertices[head.landmarks]).astype(np.float64)
    axes = _axes_of(face - face.mean(axis=0), known - known.mean(axis=0))
    unit = outer_eye_distance(face)
    hair = [child for child in obj.children if child.get(PART_PROPERTY) == "hair" and child.type == "MESH"]
    points = np.concatenate([points, *(face_points(part) for part in {*hair, *objects_of(obj)})])
    middle = face.mean(axis=0) + _DEPTH * unit * axes[:, 1]
    away, own = (points - middle) @ axes, (face - middle) @ axes
    above = away[:, 2] > own[:, 2].min()
    neck = (away[:, 2] > own[:, 2].min() - _NECK * unit) & (np.abs(away[:, 0]) < np.abs(own[:, 0]).max())
    of_head = (np.linalg.norm(away, axis=1) < _HEAD_REACH * unit) & (above | neck)
    return FaceView(points[of_head], axes)


def _axes_of(face: FloatArray, known: FloatArray) -> FloatArray:
    """Axes (3, 3) of a face's centred landmarks (66, 3), which are those of a known face, or mirrored by a scale."""
    both = [known, known * (-1.0, 1.0, 1.0)]
    turned = [(fit_rotation(one, face), one) for one in both]
    return min(turned, key=lambda pair: -float((face * (pair[1] @ pair[0].T)).sum()))[0]


def setup_preview(
    scene: bpy.types.Scene,
    head_object: bpy.types.Object,
    size: tuple[int, int] = (512, 512),
    view: FaceView | None = None,
) -> None:
    """Set up a camera in front of any mesh, and Workbench, for renders of a width and height in pixels.

    `view` is the part that is in view; by default the head in its current state.
    """
    view = face_view(head_object) if view is None else view
    points = view.points
    _aim_camera(scene, view, size)
    render = scene.render
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage, render.pixel_aspect_x, render.pixel_aspect_y = 100, 1.0, 1.0
    render.film_transparent = False
    if scene.world is None:
        scene.world = bpy.data.worlds.new("Facemime Preview")
    scene.world.color = _BACKGROUND
    set_shading(scene, float(np.ptp(points, axis=0).max()) * _FOLD_SHARE)
    show_colour_images()
    _show_in_renders(scene, head_object)


def look_at_face(view: bpy.types.RegionView3D, obj: bpy.types.Object) -> None:
    """Turn a viewport towards a head, straight in front of its face and close enough to place landmarks."""
    shown = face_view(obj)
    points = shown.points @ shown.axes
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    view.view_perspective = "ORTHO"
    view.view_rotation = _facing(shown).to_quaternion()
    view.view_location = shown.axes @ middle
    view.view_distance = _NEAR * float(np.ptp(points, axis=0)[[0, 2]].max())


def _facing(view: FaceView) -> Matrix:
    """Return the rotation of a camera that looks along the face's own axis to its back."""
    return Matrix(view.axes.tolist()) @ Matrix.Rotation(np.pi / 2.0, 3, "X")


def set_shading(scene: bpy.types.Scene, folds: float) -> None:
    """Set up Workbench to shade folds of a given size."""
    scene.render.engine = "BLENDER_WORKBENCH"  # type: ignore[assignment]  # engines register themselves
    scene.view_settings.view_transform = "Standard"  # type: ignore[assignment]  # depends on the configuration
    scene.display.render_aa = "8"
    shading = scene.display.shading
    shading.light = "STUDIO"
    shading.studio_light = _STUDIO_LIGHT
    shading.color_type = "TEXTURE"
    shading.show_cavity = True
    shading.cavity_type = "WORLD"
    shading.cavity_valley_factor, shading.cavity_ridge_factor = 1.8, 0.0
    scene.display.matcap_ssao_distance = folds
    scene.display.matcap_ssao_samples = 16
    shading.show_shadows = False
    shading.show_object_outline = False
    shading.show_specular_highlight = True


def _show_in_renders(scene: bpy.types.Scene, head: bpy.types.Object) -> None:
    """Let renders show a head with its parts, even if they are hidden or in an excluded collection.

    Other meshes that are disabled in viewports and in renders stay so, as collision shapes and other outfits are.
    """
    parts = [child for child in head.children if PART_PROPERTY in child]
    shown = [obj for obj in objects_of(head) if not (obj.hide_viewport and obj.hide_render)]
    for obj in (head, *parts, *shown):
        mute_paths(obj, ["hide_render"])
        obj.hide_render = False
    for layer in scene.view_layers:
        for place in collections_in(layer.layer_collection):
            if head.name in place.collection.all_objects:
                place.exclude = place.collection.hide_render = False


def face_points(obj: bpy.types.Object) -> NDArray[np.float64]:
    """Return (V, 3) vertices of the mesh `obj` in world space, with its modifiers unless these change their number."""
    with nullcontext() if obj.visible_get() else revealed([obj]):
        graph = evaluated_depsgraph(bpy.context)
        shown = obj.evaluated_get(graph)
        mesh = mesh_of(shown) if len(mesh_of(shown).vertices) == len(mesh_of(obj).vertices) else mesh_of(obj)
        flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
        mesh.vertices.foreach_get("co", flat)
        world = np.array(shown.matrix_world)
    return np.asarray(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])


def _aim_camera(scene: bpy.types.Scene, view: FaceView, size: tuple[int, int]) -> None:
    """Add a camera straight in front of the face, as near as possible with all points and a margin in view."""
    data = bpy.data.cameras.new("Facemime Preview")
    camera = bpy.data.objects.new("Facemime Preview", data)
    scene.collection.objects.link(camera)
    data.lens, data.sensor_width, data.sensor_fit = _LENS, _SENSOR, "HORIZONTAL"
    points = view.points @ view.axes
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2.0
    across = _SENSOR / (2.0 * _LENS * _MARGIN)
    upwards = across * size[1] / size[0]
    beside = np.abs(points - centre)
    nearest = (points[:, 1] - np.maximum(beside[:, 0] / across, beside[:, 2] / upwards)).min()
    distance = centre[1] - nearest
    camera.location = view.axes @ (centre[0], nearest, centre[2])
    camera.rotation_euler = _facing(view).to_euler()
    data.clip_start, data.clip_end = distance / 100.0, distance * 10.0
    for marker in scene.timeline_markers:  # they would change the camera as soon as the scene is shown
        marker.camera = None
    scene.camera = camera
