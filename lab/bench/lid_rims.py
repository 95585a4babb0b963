"""How far the landmarks of a character's lids are from the rims of its eyes that a picture shows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy
import cv2
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from numpy.typing import NDArray

from facemime.blender.characters import objects_of, parts_of, read_kinds
from facemime.blender.meshes import mesh_of, object_of, read_landmarks
from facemime.blender.preview_scene import face_points, setup_preview
from facemime.blender.rendering import render_frames
from facemime.core.face.landmarks import LOWER_LIDS, OUTER_EYE_CORNERS, UPPER_LIDS
from facemime.core.heads.rig import Part

_SIDE = 1024
"""Side of the picture in pixels."""
_BRIGHT = 60
"""Grey level above which a pixel shows an eye, which is white in studio light; everything else is black."""
_EYES = (Part.EYE_RIGHT, Part.EYE_LEFT)


def rim_distance(head: bpy.types.Object) -> float:
    """Return the largest distance of a lid's landmark from the rim of an eye, in outer-eye distances; NaN if there are
    no eyes.

    The rims are those of the eyes in a picture from in front.
    """
    scene = bpy.context.scene
    kinds = {obj: read_kinds(mesh_of(obj)) for obj in (head, *objects_of(head))}
    for key, obj in parts_of(head).items():
        kind = Part.EYE_RIGHT if key.startswith("eye") else Part.ON_HEAD
        kinds[obj] = np.full(len(mesh_of(obj).vertices), kind)
    if not any(np.isin(kind, _EYES).any() for kind in kinds.values()):
        return float("nan")
    with ExitStack() as stack:
        colours = [_material(level) for level in (0.0, 1.0)]
        for obj, kind in kinds.items():
            stack.enter_context(_painted(mesh_of(obj), kind, colours))
        setup_preview(scene, head, (_SIDE, _SIDE))
        (picture,) = render_frames(scene, [float(scene.frame_current)], (_SIDE, _SIDE))
    eyes = (cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) > _BRIGHT).astype(np.uint8)
    background = np.all(picture == picture[0, 0], axis=2)
    eyes[background] = 0
    camera = object_of(scene.camera)
    points = face_points(head)[read_landmarks(head)]
    seen = np.array([world_to_camera_view(scene, camera, Vector(point))[:2] for point in points])
    pixels = _SIDE * np.column_stack([seen[:, 0], 1.0 - seen[:, 1]])
    away = np.maximum(*(cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for mask in (eyes, 1 - eyes)))
    columns, rows = pixels[np.r_[UPPER_LIDS, LOWER_LIDS]].round().astype(int).T
    right, left = pixels[OUTER_EYE_CORNERS]
    return float(away[rows, columns].max() / np.linalg.norm(right - left))


def _material(level: float) -> bpy.types.Material:
    material = bpy.data.materials.new("Rims")
    material.diffuse_color = (level, level, level, 1.0)
    return material


@contextmanager
def _painted(mesh: bpy.types.Mesh, kinds: NDArray[np.integer], colours: list[bpy.types.Material]) -> Iterator[None]:
    """Show the eyes of a mesh, of the parts `kinds` (V,), in the second colour and the rest in the first."""
    own, numbers = list(mesh.materials), np.zeros(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("material_index", numbers)
    first = np.array([polygon.vertices[0] for polygon in mesh.polygons], dtype=np.intp)
    _assign(mesh, colours, np.isin(kinds[first], _EYES))
    try:
        yield
    finally:
        _assign(mesh, own, numbers)


def _assign(mesh: bpy.types.Mesh, materials: list[bpy.types.Material | None], numbers: NDArray[Any]) -> None:
    """Give a mesh materials, and each of its polygons one of them, (F,)."""
    mesh.materials.clear()
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", numbers.astype(np.int32))
