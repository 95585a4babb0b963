"""Animation of a character's shape keys that plays in addition to a bake, such as an imported one."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..actions import mute_others, others_playing
from ..characters import objects_of


def playing_under(head: bpy.types.Object) -> list[str]:
    """Return the names of actions and NLA tracks that move shape keys of a character in addition to a bake.

    Parameters
    ----------
    head : bpy.types.Object
    """
    return list(dict.fromkeys(name for keys in _shape_keys(head) for name in others_playing(keys)))


def mute_under(head: bpy.types.Object) -> int:
    """Mute the animation that `playing_under` names, and return how many curves and tracks were muted."""
    return sum(mute_others(keys) for keys in _shape_keys(head))


def _shape_keys(head: bpy.types.Object) -> Iterator[bpy.types.Key]:
    for obj in (head, *objects_of(head)):
        if obj.data.shape_keys is not None:
            yield obj.data.shape_keys
