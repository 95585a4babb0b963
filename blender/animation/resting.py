"""Values of shape keys without what a session shows on them."""

from __future__ import annotations

import json
from collections.abc import Sequence

import bpy

from ..characters import Member
from ..meshes import keys_of, mesh_of
from ..names import VALUES_PROPERTY


def resting_values(members: Sequence[Member], names: Sequence[str]) -> dict[str, float]:
    """Return the values of shape keys without what a session shows."""
    found: dict[str, float] = {}
    for obj in (member.obj for member in members if mesh_of(member.obj).shape_keys is not None):
        kept, blocks = kept_values(keys_of(obj)), keys_of(obj).key_blocks
        for name in names:
            if name in blocks:
                found.setdefault(name, kept.get(name, blocks[name].value))
    return found


def kept_values(keys: bpy.types.Key) -> dict[str, float]:
    """Return the values that shape keys had before a session, even one that ended in a crash."""
    try:
        values = json.loads(str(keys.get(VALUES_PROPERTY, "{}")))
    except ValueError:
        return {}
    return {name: value for name, value in values.items() if isinstance(value, (int, float))}
