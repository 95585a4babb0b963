"""Picture of a face with its landmarks."""

from __future__ import annotations

import bpy
import cv2
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from numpy.typing import NDArray

from ...core.face.landmarks import EDGES
from ..media.preview_scene import face_points, setup_preview
from ..media.rendering import render_frames
from ..meshes import object_of, read_landmarks

_LINE = (80, 220, 80)
_POINT = (255, 255, 255)


def draw_landmarks(scene: bpy.types.Scene, head: bpy.types.Object, side: int) -> NDArray[np.uint8]:
    """Render a face from the front, with the landmarks drawn over it.

    Parameters
    ----------
    scene : bpy.types.Scene
        A preview camera is added.
    head : bpy.types.Object
        A mesh with landmarks.
    side : int
        Width and height, pixels.

    Returns
    -------
    (side, side, 3) uint8
        BGR.
    """
    setup_preview(scene, head, (side, side))
    (picture,) = render_frames(scene, np.array([float(scene.frame_current)]), (side, side))
    points = face_points(head)[read_landmarks(head)]
    camera = object_of(scene.camera)
    seen = [world_to_camera_view(scene, camera, Vector(point)) for point in points]
    pixels = [(round(place.x * side), round((1.0 - place.y) * side)) for place in seen]
    drawn = np.ascontiguousarray(picture)
    for a, b in EDGES:
        cv2.line(drawn, pixels[a], pixels[b], _LINE, 1, cv2.LINE_AA)
    for pixel in pixels:
        cv2.circle(drawn, pixel, 2, _POINT, -1, cv2.LINE_AA)
    return np.asarray(drawn, dtype=np.uint8)
