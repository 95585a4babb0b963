"""Shape keys of a head's own that drive it live."""

from __future__ import annotations

import bpy

from ...core.bake.key_map import KeyMap
from ...core.errors import HeadError
from ...core.live.key_driver import LiveKeys
from ..characters import members_of
from ..meshes import driven_by_keys
from .bake_keys import has_known_set, read_keys
from .puppet import table_for

AUTOMATIC, SKIN, KEYS = "AUTOMATIC", "SKIN", "KEYS"


def live_keys(obj: bpy.types.Object, choice: str, table: KeyMap | None = None) -> LiveKeys | None:
    """Return the shape keys that drive a head live; None if its skin is driven.

    Parameters
    ----------
    choice : {"AUTOMATIC", "SKIN", "KEYS"}
        "AUTOMATIC" takes the keys of a character that has a known set of them; the built-in head's skin shows more.
    table : KeyMap, optional
        The key mapping; by default the preset that fits best.

    Raises
    ------
    HeadError
        If keys were requested but the head has none, or no mapping matches them.
    """
    if driven_by_keys(obj) and choice == SKIN:
        raise HeadError(
            "{name} is bound by its shape keys alone. Drive it by its keys, or find its face.", name=obj.name
        )
    if driven_by_keys(obj):
        choice = KEYS
    if choice == SKIN or (choice == AUTOMATIC and not has_known_set(obj)):
        return None
    chosen = table_for(obj, table)
    keys = read_keys(members_of(obj))
    used = [name for name in chosen.keys if name in keys.names]
    offsets = dict(zip(keys.names, keys.offsets, strict=True))
    return LiveKeys(chosen, {name: offsets[name] for name in used}, {name: keys.ranges[name] for name in used})


def names_of(keys: LiveKeys | None) -> tuple[str, ...]:
    """Return the names of the shape keys that drive a head, in the order of `HeadFrame.keys`; () for its skin."""
    return () if keys is None else tuple(keys.offsets)
