"""What a user has changed on a head that shows a take, which it is taught: by shape keys, or in the shown shape itself.

Changes are relative to the values that the keys had when the preview started, as characters often stand in a shape of
their own, by keys for a person or an age.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.drive.driver import HeadFrame
from ..characters import Member, members_of
from ..meshes import key_names, key_points, keys_of, mesh_of
from ..muting import varying_paths
from .bake_keys import scaled_offsets, value_path
from .live_mesh import LIVE_KEY

_EDITED = 1e-5
"""Smallest change of a shape key's value that counts."""
Values = Mapping[tuple[int, str], float]
"""Values of shape keys by the `session_uid` of the object and the name of the key."""


def own_values(head: bpy.types.Object) -> Values:
    """Return the values of the user's shape keys of a head that its animation does not change."""
    return {(obj.session_uid, block.name): block.value for obj, block in _still_blocks(members_of(head))}


def edited_shape(head: bpy.types.Object, frame: HeadFrame, before: Values) -> NDArray[np.float32]:
    """Return the vertices (A, 3) as they are on the mesh of a head that shows a frame by its live key.

    `before` are the values of the shape keys without the user's changes.
    """
    wanted = np.array(frame.vertices, dtype=np.float32)
    for member in members_of(head):
        mesh = mesh_of(member.obj)
        live = None if mesh.shape_keys is None else mesh.shape_keys.key_blocks.get(LIVE_KEY)
        if live is not None:
            moved = key_points(live) - member.local(frame.vertices).reshape(-1, 3)
            wanted[member.part] += member.head_offsets(moved)
        for obj, block in _still_blocks([member]):
            if change := _change(obj, block, before):
                wanted[member.part] += np.float32(change) * member.head_offsets(scaled_offsets(obj, block))
    return wanted


def edited_keys(
    head: bpy.types.Object, shown: Mapping[str, float], before: Values
) -> tuple[dict[str, float], dict[str, float]]:
    """Return values of shape keys as a frame shows them, and as they are; without those that are the same.

    `shown` are the values of the keys that drive the head. Others are compared with their values `before`.
    """
    old, new = {}, {}
    for obj, block in _still_blocks(members_of(head)):
        start = shown.get(block.name, before.get((obj.session_uid, block.name), 0.0))
        if block.name not in old and abs(block.value - start) > _EDITED:
            old[block.name], new[block.name] = start, block.value
    return old, new


def reset_keys(head: bpy.types.Object, driven: Sequence[str], before: Values) -> list[str]:
    """Give shape keys other than the `driven` ones the values that they had before.

    Returns the names of those that did not keep them, as drivers move them.
    """
    changed = [
        (obj, block.name)
        for obj, block in _still_blocks(members_of(head))
        if block.name not in driven and _change(obj, block, before)
    ]
    for obj, name in changed:
        keys_of(obj).key_blocks[name].value = before.get((obj.session_uid, name), 0.0)
    bpy.context.view_layer.update()
    return list(dict.fromkeys(name for obj, name in changed if _change(obj, keys_of(obj).key_blocks[name], before)))


def _still_blocks(members: Sequence[Member]) -> Iterator[tuple[bpy.types.Object, bpy.types.ShapeKey]]:
    """Yield the user's shape keys of a head that are not muted and not animated, with their objects."""
    for obj in (member.obj for member in members):
        if (keys := mesh_of(obj).shape_keys) is None:
            continue
        varying = varying_paths(keys)
        for name in key_names(obj):
            block = keys.key_blocks[name]
            if not block.mute and value_path(name) not in varying:
                yield obj, block


def _change(obj: bpy.types.Object, block: bpy.types.ShapeKey, before: Values) -> float:
    change = block.value - before.get((obj.session_uid, block.name), 0.0)
    return change if abs(change) > _EDITED else 0.0
