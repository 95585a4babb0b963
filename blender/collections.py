"""Collections in a view layer, and objects that they or something else hides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import bpy

from .muting import mute_for_now


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
    """Set a property until a stack ends.

    Parameters
    ----------
    name : str
        Name of the property.
    """
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
