"""Animation of a character's shape keys that would play in addition to a bake, such as an imported one."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ...core.drive.motion import HeadMotion
from ..characters import Member, members_of, objects_of
from ..meshes import key_names, key_offsets, keys_of, mesh_of
from ..muting import Silenced, mute_others, mute_paths, others_playing
from .bake_keys import value_path
from .key_drivers import family_keys, moved_paths

_STILL = 1e-6
"""Largest motion of a vertex that does not move, in the unit of the head."""


def playing_under(head: bpy.types.Object) -> list[str]:
    """Return the names of actions and NLA tracks that move shape keys of a character in addition to a bake.

    Parameters
    ----------
    head : bpy.types.Object
    """
    return list(dict.fromkeys(name for keys in _shape_keys(head) for name in others_playing(keys)))


def mute_under(head: bpy.types.Object) -> int:
    """Mute the animation that `playing_under` names, and return how many curves and tracks were muted."""
    return sum(len(mute_others(keys)) for keys in _shape_keys(head))


def mute_disturbing(head: bpy.types.Object, motion: HeadMotion) -> list[Silenced]:
    """Mute what animates shape keys of a head that move the same vertices as a bake, and return what that was."""
    members, silenced = members_of(head), []
    family = family_keys(members)
    for member in members:
        if (keys := mesh_of(member.obj).shape_keys) is not None:
            paths = _moving_the_same(member, motion)
            silenced += mute_others(keys, paths)
            silenced += mute_paths(keys, paths & moved_paths(keys, family), curves=False)
    return silenced


def _moving_the_same(member: Member, motion: HeadMotion) -> set[str]:
    """Return the data paths of the user's keys of a mesh that move vertices which a motion moves."""
    moved = np.abs(motion.vertices[:, member.part]).max(axis=(0, 2), initial=0.0) > _STILL
    blocks = keys_of(member.obj).key_blocks
    offsets = {name: np.abs(key_offsets(blocks[name])[moved]) for name in key_names(member.obj)}
    return {value_path(name) for name, of in offsets.items() if of.max(initial=0.0) > _STILL}


def _shape_keys(head: bpy.types.Object) -> Iterator[bpy.types.Key]:
    for obj in (head, *objects_of(head)):
        if (keys := mesh_of(obj).shape_keys) is not None:
            yield keys
