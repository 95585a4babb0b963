"""Drivers of shape keys: those that make keys follow others of the same character, and those that others move."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..characters import Member
from ..muting import keyed_paths

_KEY_BLOCKS = "key_blocks["
"""What the data path of a shape key contains, from its data-block, its mesh or its object."""


def following_paths(members: Sequence[Member], obj: bpy.types.Object) -> set[str]:
    """Return the data paths of shape keys of a mesh whose drivers make them follow keys of a head.

    Lashes, brows and teeth often have the keys of the head, driven by these, and correctives depend on other keys.

    Parameters
    ----------
    members : sequence of Member
        Meshes of the head.
    obj : bpy.types.Object
        One of them.
    """
    sources = {
        block for member in members for block in (member.obj, member.obj.data, member.obj.data.shape_keys) if block
    }
    return {driver.data_path for driver in _playing(obj) if _reads_keys(driver, sources)}


def moved_paths(members: Sequence[Member], obj: bpy.types.Object) -> set[str]:
    """Return the data paths of shape keys of a mesh with drivers that follow something animated, such as bones."""
    following = following_paths(members, obj)
    return {
        driver.data_path
        for driver in _playing(obj)
        if driver.data_path not in following and any(keyed_paths(source) for source in _sources(driver))
    }


def _playing(obj: bpy.types.Object) -> list[bpy.types.FCurve]:
    keys = obj.data.shape_keys
    if keys is None or keys.animation_data is None:
        return []
    return [driver for driver in keys.animation_data.drivers if not driver.mute]


def _reads_keys(driver: bpy.types.FCurve, sources: set[bpy.types.ID]) -> bool:
    targets = (target for variable in driver.driver.variables for target in variable.targets)
    return any(target.id in sources and _KEY_BLOCKS in target.data_path for target in targets)


def _sources(driver: bpy.types.FCurve) -> set[bpy.types.ID]:
    targets = (target for variable in driver.driver.variables for target in variable.targets)
    return {target.id for target in targets if target.id is not None}
