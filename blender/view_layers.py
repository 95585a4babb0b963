"""Objects in a view layer: their collections, what hides them, their selection, and free space for a new one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from numpy.typing import NDArray

from .contexts import evaluated_depsgraph
from .muting import mute_for_now

_GAP = 2.0
"""Space between two objects, relative to the width of the new one: a view of it does not show the other."""
_SIDES = ((0, 1), (0, -1), (1, -1), (1, 1))
"""Axis and direction: right, left, in front, behind."""
_SURROUNDINGS = 20.0
"""Objects larger than the new one by this factor are taken to surround it, such as a room, a ground or a sky."""


def collections_in(place: bpy.types.LayerCollection) -> Iterator[bpy.types.LayerCollection]:
    """Yield all collections below one of a view layer, parents first: excluding one excludes those in it."""
    for child in place.children:
        yield child
        yield from collections_in(child)


def show(objects: Sequence[bpy.types.Object]) -> bool:
    """Show objects in the view layer, with the collections that have them, and return whether some were hidden."""
    layer, wanted = bpy.context.view_layer, [obj for obj in objects if not obj.visible_get()]
    if not wanted:
        return False
    for place in collections_in(layer.layer_collection):
        if set(wanted).intersection(place.collection.all_objects):
            place.exclude = place.hide_viewport = place.collection.hide_viewport = False
    for obj in wanted:
        obj.hide_viewport = False
    layer.update()
    for obj in wanted:
        if obj.name in layer.objects:
            obj.hide_set(False)
    return True


@contextmanager
def revealed(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Make objects visible and selectable in the view layer for a while, with the collections that have them.

    Blender evaluates and selects only what is visible. Animation and drivers that hide an object are muted.
    """
    layer, scene = bpy.context.view_layer, bpy.context.scene
    wanted = set(objects)
    with ExitStack() as stack:
        for place in collections_in(layer.layer_collection):
            if wanted.intersection(place.collection.all_objects):
                set_for_now(stack, place, "exclude", False)
                set_for_now(stack, place, "hide_viewport", False)
                for name in ("hide_viewport", "hide_select"):
                    set_for_now(stack, place.collection, name, False)
        for obj in objects:
            if obj.name not in layer.objects:  # of another scene
                scene.collection.objects.link(obj)
                stack.callback(scene.collection.objects.unlink, obj)
            mute_for_now(stack, obj, ["hide_viewport"])
            for name in ("hide_viewport", "hide_select"):
                set_for_now(stack, obj, name, False)
        layer.update()
        for obj in objects:
            if obj.hide_get():
                obj.hide_set(False)
                stack.callback(_hide, obj)
        yield


def set_for_now(stack: ExitStack, owner: Any, name: str, value: Any) -> None:
    """Set a property until a stack ends."""
    before = getattr(owner, name)
    if before != value:
        stack.callback(_restore, owner, name, before)
        setattr(owner, name, value)


def _restore(owner: Any, name: str, value: Any) -> None:
    with suppress(ReferenceError):  # it was deleted
        setattr(owner, name, value)


def _hide(obj: bpy.types.Object) -> None:
    with suppress(ReferenceError):
        obj.hide_set(True)


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Select an object and nothing else, and make it active."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def free_place(context: bpy.types.Context, obj: bpy.types.Object, place: Vector) -> Vector:
    """Return where an object at the origin of the scene intersects no other: at `place`, or beside what is there.

    Of the sides, the first that the scene's camera sees is taken: right, left, in front, behind; otherwise the right.
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
    """Return whether the scene's camera sees a ball with its centre at `place`."""
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
    return not scene.ray_cast(evaluated_depsgraph(context), start, point - start, distance=away)[0]


def _box(obj: bpy.types.Object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest corner of an object in the scene."""
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    return corners.min(axis=0), corners.max(axis=0)
