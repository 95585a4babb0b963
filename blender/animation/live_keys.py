"""Shape keys of a head's own during a session: which of them drive it live, and their values, which are restored at its
end.

The values themselves are set, rather than a shape that looks the same, so that the user's drivers, correctives and
sliders follow. The values before are kept in a custom property of the data-block, and restored from there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.own_keys import lid_factors
from ...core.drive.teaching import TaughtKeys
from ...core.errors import HeadError
from ...core.heads.key_map import KeyMap
from ...core.puppet.outputs import LiveKeys
from ..characters import members_of, whole_face
from ..meshes import driven_by_keys, exists, make_room
from ..names import VALUES_PROPERTY
from ..styles import read_style
from .aside import kept_values, moving, resting_values, restore, set_aside
from .bake_keys import has_known_set, read_keys, value_path
from .puppet import table_for

AUTOMATIC, SKIN, KEYS = "AUTOMATIC", "SKIN", "KEYS"


def live_keys(obj: bpy.types.Object, choice: str, table: KeyMap | None = None) -> LiveKeys | None:
    """Return the shape keys that drive a head live, or None if its skin is driven.

    The choice is "AUTOMATIC", "SKIN" or "KEYS". "AUTOMATIC" takes the keys of a character that has a known set of them;
    the built-in head's skin shows more. Without a key mapping, the preset that fits best is used. Keys that were taught
    are added to those of the mapping. Raises HeadError if keys were requested but the head has none, or no mapping
    matches them.
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
    members = members_of(obj)
    keys = read_keys(members)
    used = [name for name in chosen.keys if name in keys.names]
    added = [name for name in TaughtKeys(read_style(obj)).names if name in keys.names and name not in used]
    used += added
    offsets = dict(zip(keys.names, keys.offsets, strict=True))
    left, right = lid_factors(*whole_face(obj), chosen, offsets).tolist()
    return LiveKeys(
        chosen,
        {name: offsets[name] for name in used},
        {name: keys.ranges[name] for name in used},
        rest=resting_values(members, added),
        lids=(left, right),
    )


def names_of(keys: LiveKeys | None) -> tuple[str, ...]:
    """Return the names of the shape keys that drive a head, in the order of `HeadFrame.keys`; () for its skin."""
    return () if keys is None else tuple(keys.offsets)


class LiveValues:
    """Shape keys of a mesh that display a performance.

    Those of the `names` that the mesh does not have are left out. `following` are data paths of values with drivers
    that follow keys of the head, which are left alone.
    """

    def __init__(self, keys: bpy.types.Key, names: Sequence[str], following: set[str]) -> None:
        self._keys = keys
        blocks = self._keys.key_blocks
        self._places = {
            blocks.find(name): number
            for number, name in enumerate(names)
            if name in blocks and value_path(name) not in following
        }
        self._extended: dict[int, tuple[float, float]] = {}

    def attach(self) -> None:
        """Remember the values, and set aside what animates or drives them."""
        blocks = self._keys.key_blocks
        places = [place for place in self._places if place < len(blocks)]
        if VALUES_PROPERTY not in self._keys:
            kept = {blocks[place].name: [blocks[place].value, place] for place in places}
            self._keys[VALUES_PROPERTY] = json.dumps(kept)
        set_aside(self._keys, moving(self._keys, [value_path(blocks[place].name) for place in places]))

    def write(self, values: NDArray[Any]) -> None:
        """Set the values, (K,) in the order of the names."""
        blocks = self._keys.key_blocks
        every = np.empty(len(blocks), dtype=np.float32)
        blocks.foreach_get("value", every)
        wanted = every.copy()
        for place, number in self._places.items():
            wanted[place] = values[number]
        if not np.array_equal(every, wanted):
            self._make_room(values)
            blocks.foreach_set("value", wanted)
            first = blocks[next(iter(self._places))]
            first.value = first.value  # a bulk write does not update the scene

    def _make_room(self, values: NDArray[Any]) -> None:
        """Extend the ranges of keys that have to exceed 1 to shut the eyes, or move both ways, and remember them."""
        for place, number in self._places.items():
            if not 0.0 <= values[number] <= 1.0:
                block = self._keys.key_blocks[place]
                self._extended.setdefault(place, (block.slider_min, block.slider_max))
                make_room(block, float(values[number]))

    def detach(self, *, keep: bool) -> None:
        """Restore the values and ranges, or leave them as they are if `keep`, and what was set aside."""
        if not exists(self._keys):
            return
        if keep:
            self._keys.pop(VALUES_PROPERTY, None)
        clear_values(self._keys)
        if not keep:
            blocks = self._keys.key_blocks
            for place, ends in self._extended.items():
                if place < len(blocks):
                    blocks[place].slider_min, blocks[place].slider_max = ends
        restore(self._keys)


def clear_values(keys: bpy.types.Key) -> None:
    """Restore the values that shape keys had before a session, even one that ended in a crash."""
    for name, value in kept_values(keys).items():
        if (block := keys.key_blocks.get(name)) is not None:
            block.value = value
    keys.pop(VALUES_PROPERTY, None)
