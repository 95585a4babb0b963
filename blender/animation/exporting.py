"""What exporters leave out, made part of a file for as long as it is written.

Exporters take what is selected, and Blender selects nothing that is hidden, unselectable or in an excluded collection,
without a word. That of glTF leaves out muted shape keys, and the vertex groups and relative keys of others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import bpy
import numpy as np

from ...core.errors import OutputError
from ..collections import revealed, set_for_now
from ..meshes import key_points, keys_of, mesh_of
from ..muting import mute_for_now
from .bake_keys import scaled_offsets, value_path


@contextmanager
def selected_for_export(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Select some objects and nothing else, whatever hides them; the first is active. All returns to what it was.

    Raises
    ------
    OutputError
        If an object cannot be selected, so that an exporter would leave it out.
    """
    layer = bpy.context.view_layer
    selected, active = [obj for obj in layer.objects if obj.select_get()], layer.objects.active
    with ExitStack() as stack:
        stack.callback(_select, selected, active)
        stack.enter_context(revealed(objects))
        _select(objects, objects[0])
        if missing := [obj.name for obj in objects if not obj.select_get()]:
            names = ", ".join(missing)
            raise OutputError(
                "These objects cannot be exported: {names}. Show them and make them selectable.", names=names
            )
        yield


def _select(objects: Sequence[bpy.types.Object], active: bpy.types.Object | None) -> None:
    """Select objects and nothing else."""
    layer = bpy.context.view_layer
    layer.update()  # what was hidden or excluded has no effect before
    for obj in layer.objects:
        obj.select_set(obj in objects)
    layer.objects.active = active


@contextmanager
def keys_as_shown(objects: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Give the shape keys of some meshes the points that show what they do, all relative to the Basis.

    A muted key stays among them, with the value 0.
    """
    meshes = {mesh_of(obj): obj for obj in objects if obj.type == "MESH" and mesh_of(obj).shape_keys is not None}
    with ExitStack() as stack:
        for obj in meshes.values():
            keys = keys_of(obj)
            if keys.use_relative and keys.library is None:
                _show_muted(stack, keys)
                _write_offsets(stack, obj)
        yield


def _show_muted(stack: ExitStack, keys: bpy.types.Key) -> None:
    """Unmute keys and hold them at 0, against what animates them."""
    muted = [key for key in keys.key_blocks if key.mute]
    mute_for_now(stack, keys, {value_path(key.name) for key in muted})
    for key in muted:
        set_for_now(stack, key, "value", 0.0)
        set_for_now(stack, key, "mute", False)


def _write_offsets(stack: ExitStack, obj: bpy.types.Object) -> None:
    """Put vertex groups and relative keys into the points of keys that have them."""
    keys = keys_of(obj)
    basis = keys.reference_key
    limited = [
        key
        for key in keys.key_blocks
        if key != basis and (key.vertex_group in obj.vertex_groups or key.relative_key != basis)
    ]
    before = [key_points(key) for key in limited]
    shown = [key_points(basis) + scaled_offsets(obj, key) for key in limited]
    for key, old, new in zip(limited, before, shown, strict=True):
        stack.callback(key.points.foreach_set, "co", np.ascontiguousarray(old).reshape(-1))
        key.points.foreach_set("co", np.ascontiguousarray(new, dtype=np.float32).reshape(-1))
        set_for_now(stack, key, "vertex_group", "")
        set_for_now(stack, key, "relative_key", basis)
    if limited:
        stack.callback(mesh_of(obj).update_tag)
        mesh_of(obj).update_tag()
