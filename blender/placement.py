"""Free space for a new object, and its selection."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

_GAP = 2.0
"""Space between two objects, relative to the width of the new one: a view of it does not show the other."""
_SURROUNDINGS = 20.0
"""Objects larger than the new one by this factor are taken to surround it, such as a room, a ground or a sky."""


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Select an object and nothing else, and make it active."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def free_place(context: bpy.types.Context, obj: bpy.types.Object, place: Vector) -> Vector:
    """Return a position where an object intersects no other: `place`, or otherwise to the right of the objects there.

    Parameters
    ----------
    context : bpy.types.Context
    obj : bpy.types.Object
        At the origin of the scene.
    place : mathutils.Vector
        Preferred location.
    """
    context.view_layer.update()
    low, high = _box(obj)
    size = high - low
    others = [
        _box(other)
        for other in context.visible_objects
        if other != obj and other.parent != obj and other.type in {"MESH", "CURVE", "SURFACE", "META", "FONT"}
    ]
    others = [box for box in others if (box[1] - box[0]).max() < _SURROUNDINGS * size.max()]
    found = np.array(place)
    while others:
        hit = [box for box in others if (box[0] < found + high).all() and (box[1] > found + low).all()]
        if not hit:
            break
        found[0] = max(box[1][0] for box in hit) + _GAP * size[0] - low[0]
    return Vector(found)


def _box(obj: bpy.types.Object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest corner of an object in the scene."""
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    return corners.min(axis=0), corners.max(axis=0)
