"""Shape keys of ARKit's face units, made on a user's own head."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.drive.expression_keys import expression_keys
from ...core.errors import HeadError
from ..characters import Member, members_of
from ..meshes import mesh_of, require_own
from ..rigs import read_rig

_STILL = 1e-5
"""Share of the eye distance below which no vertex of a mesh moves: other meshes than the head then get no keys."""


def make_expression_keys(obj: bpy.types.Object | None) -> tuple[int, int]:
    """Add the 52 face units to all meshes of a head that they move; existing keys of these names are kept.

    Parameters
    ----------
    obj : bpy.types.Object or None
        A mesh with landmarks.

    Returns
    -------
    added, kept : int
        Keys of the head that were added, and that existed already.

    Raises
    ------
    HeadError
        If the object is not a head, a mesh is linked from another file, or its shape keys are absolute.
    """
    mesh_of(obj)
    members = members_of(obj)
    for member in members:
        require_own(member.obj.data)
        if (keys := member.obj.data.shape_keys) is not None and not keys.use_relative:
            raise HeadError(f"The shape keys of {member.obj.name} are absolute. Enable Relative first.")
    rig = read_rig(obj)
    names, motions = expression_keys(rig)
    added = 0
    for member in members:
        offsets = member.local_offsets(motions)
        if member.obj != obj and np.abs(motions[:, member.part]).max() < _STILL * rig.eye_distance:
            continue
        count = _add(member, names, offsets)
        added = count if member.obj == obj else added
    return added, len(names) - added


def _add(member: Member, names: tuple[str, ...], offsets: np.ndarray) -> int:
    obj = member.obj
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis", from_mix=False)
    keys = obj.data.shape_keys
    rest = np.empty(3 * len(obj.data.vertices), dtype=np.float32)
    keys.reference_key.points.foreach_get("co", rest)
    missing = [(name, row) for name, row in zip(names, offsets, strict=True) if name not in keys.key_blocks]
    for name, row in missing:
        key = obj.shape_key_add(name=name, from_mix=False)
        key.points.foreach_set("co", rest + row.reshape(-1))
        key.value = 0.0  # since Blender 5.0 the default is 1
    return len(missing)
