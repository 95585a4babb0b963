"""Conversion of a scene's key mapping to a `KeyMap` and back."""

from __future__ import annotations

from ..core.bake.key_map import KeyMap, KeyRow
from ..core.errors import FacemimeError
from .takes_properties import FacemimeBake


def read_table(bake: FacemimeBake) -> KeyMap:
    """Return the key mapping; raises FacemimeError if a row has no key."""
    for number, row in enumerate(bake.rows, start=1):
        if not row.key:
            raise FacemimeError(
                "Row {number} of the key mapping has no shape key. Choose one, or remove the row.", number=number
            )
    return table_so_far(bake)


def table_so_far(bake: FacemimeBake) -> KeyMap:
    """Return the key mapping without the rows that have no key yet."""
    rows = (KeyRow(row.source, row.key, row.gain, row.offset) for row in bake.rows if row.key)
    return KeyMap(bake.table or "Mapping", tuple(rows))


def write_table(bake: FacemimeBake, table: KeyMap) -> None:
    """Replace the rows and the name of the key mapping with those of `table`."""
    bake.table = table.name
    bake.rows.clear()
    for row in table.rows:
        line = bake.rows.add()
        line.source, line.key, line.gain, line.offset = row.source, row.key, row.gain, row.offset
    bake.row = 0
