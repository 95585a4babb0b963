"""Free space for a new object, and its selection."""

from __future__ import annotations

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from numpy.typing import NDArray

_GAP = 2.0
"""Space between two objects, relative to the width of the new one: a view of it does not show the other."""
_SIDES = ((0, 1), (0, -1), (1, -1), (1, 1))
"""Axis and direction: right, left, in front, behind."""
_SURROUNDINGS = 20.0
"""Objects larger than the new one by this factor are taken to surround it, such as a room, a ground or a sky."""


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Select an object and nothing else, and make it active."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def free_place(context: bpy.types.Context, obj: bpy.types.Object, place: Vector) -> Vector:
    """Return a position where an object intersects no other: `place`, or otherwise beside the objects there.

    Of the sides, the first that the scene's camera sees is taken: right, left, in front, behind; otherwise the right.

    Parameters
    ----------
    obj : bpy.types.Object
        At the origin of the scene.
    """
    context.view_layer.update()
    own = _box(obj)
    size = own[1] - own[0]
    others = [
        _box(other)
        for other in context.visible_objects
        if other != obj and other.parent != obj and other.type in {"MESH", "CURVE", "SURFACE", "META", "FONT"}
    ]
    others = [box for box in others if (box[1] - box[0]).max() < _SURROUNDINGS * size.max()]
    found = [_beside(np.array(place), own, others, axis, side) for axis, side in _SIDES]
    middle = (own[0] + own[1]) / 2
    seen = [spot for spot in found if is_seen_by_camera(context, spot + middle, float(size.max()) / 2)]
    return Vector((seen or found)[0].tolist())


def _beside(
    place: NDArray[np.float64],
    own: tuple[NDArray[np.float64], NDArray[np.float64]],
    others: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
    axis: int,
    side: int,
) -> NDArray[np.float64]:
    """Return where a box, `own`, intersects no other one, starting at `place` and going along an axis to a side."""
    low, high = own
    gap = _GAP * (high - low)[axis]
    found = place.copy()
    while hit := [box for box in others if (box[0] < found + high).all() and (box[1] > found + low).all()]:
        if side > 0:
            found[axis] = max(box[1][axis] for box in hit) + gap - low[axis]
        else:
            found[axis] = min(box[0][axis] for box in hit) - gap - high[axis]
    return found


def is_seen_by_camera(context: bpy.types.Context, place: NDArray[np.float64], radius: float) -> bool:
    """Return whether the scene's camera sees a ball.

    Parameters
    ----------
    place : (3,) array
        Its centre.
    """
    scene, point = context.scene, Vector(place.tolist())
    camera = scene.camera
    if camera is None:
        return False
    right = camera.matrix_world.to_quaternion() @ Vector((radius, 0.0, 0.0))
    ends = [world_to_camera_view(scene, camera, point + way) for way in (right, -right, Vector((0.0, 0.0, radius)))]
    if not all(0.0 < end.x < 1.0 and 0.0 < end.y < 1.0 and end.z > 0.0 for end in ends):
        return False
    start = camera.matrix_world.translation
    away = (point - start).length - radius
    return not scene.ray_cast(context.evaluated_depsgraph_get(), start, point - start, distance=away)[0]


def _box(obj: bpy.types.Object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest corner of an object in the scene."""
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    return corners.min(axis=0), corners.max(axis=0)
