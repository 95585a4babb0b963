"""The shape in which a character stands: its Basis and the shape keys that hold its identity, such as those of a face.

Characters are often one mesh with keys for each person or age, whose values stay. What replaces the shape, or is
compared with it, has to contain them.
"""

from __future__ import annotations

from collections.abc import Collection

import bpy
import numpy as np
from numpy.typing import NDArray

from ..characters import head_of, members_of
from ..frames import from_blender
from ..meshes import key_names, mesh_of, read_vertices
from ..muting import varying_paths
from .bake_keys import scaled_offsets, value_path
from .key_drivers import family_keys, moved_paths


def standing_vertices(obj: bpy.types.Object, without: Collection[str] = ()) -> NDArray[np.float32]:
    """Return the vertices of a mesh with the user's keys whose values do not change, (V, 3) in the head frame.

    Parameters
    ----------
    obj : bpy.types.Object
        A mesh of a head.
    without : collection of str
        Names of keys that do not count.
    """
    vertices, keys = read_vertices(mesh_of(obj)), mesh_of(obj).shape_keys
    if keys is None or not keys.use_relative:
        return vertices
    moving = varying_paths(keys) | moved_paths(keys, family_keys(members_of(head_of(obj))) | {keys})
    for name in key_names(obj):
        block = keys.key_blocks[name]
        if block.value and not block.mute and name not in without and value_path(name) not in moving:
            vertices = vertices + np.float32(block.value) * from_blender(scaled_offsets(obj, block))
    return np.asarray(vertices, dtype=np.float32)
