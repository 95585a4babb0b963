"""Drivers of shape keys: those that make keys follow others of the same character, and those that others move."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import bpy

from ..characters import Member
from ..meshes import mesh_of
from ..muting import keyed_paths

_KEY_BLOCKS = "key_blocks["
"""What the data path of a shape key contains, from its data-block, its mesh or its object."""


def family_keys(members: Sequence[Member]) -> set[bpy.types.Key]:
    """Return the data-blocks of the shape keys of a head."""
    return {keys for member in members if (keys := mesh_of(member.obj).shape_keys) is not None}


def following_paths(keys: bpy.types.Key, family: Collection[bpy.types.Key]) -> set[str]:
    """Return the data paths of shape keys of a mesh whose drivers make them follow keys of a head.

    Lashes, brows and teeth often have the keys of the head, driven by these, and correctives depend on other keys.

    Parameters
    ----------
    family : collection of bpy.types.Key
        Of all meshes of the head.
    """
    return {driver.data_path for driver in _playing(keys) if _reads(driver, family)}


def moved_paths(keys: bpy.types.Key, family: Collection[bpy.types.Key]) -> set[str]:
    """Return the data paths of shape keys of a mesh with drivers that follow something else that is animated, as bones.

    Parameters are as for `following_paths`.
    """
    return {
        driver.data_path
        for driver in _playing(keys)
        if not _reads(driver, family) and any(keyed_paths(target.id) for target in _targets(driver) if target.id)
    }


def _playing(keys: bpy.types.Key) -> list[bpy.types.FCurve]:
    data = keys.animation_data
    return [] if data is None else [driver for driver in data.drivers if not driver.mute]


def _reads(driver: bpy.types.FCurve, family: Collection[bpy.types.Key]) -> bool:
    return any(_KEY_BLOCKS in target.data_path and _keys_of(target.id) in family for target in _targets(driver))


def _targets(driver: bpy.types.FCurve) -> list[bpy.types.DriverTarget]:
    variables = () if driver.driver is None else driver.driver.variables
    return [target for variable in variables for target in variable.targets]


def _keys_of(block: bpy.types.ID | None) -> bpy.types.Key | None:
    """Return the shape keys to which a path leads from their own data-block, their mesh or its object."""
    if isinstance(block, bpy.types.Object):
        block = block.data
    return block if isinstance(block, bpy.types.Key) else getattr(block, "shape_keys", None)
