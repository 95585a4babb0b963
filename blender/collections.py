"""Collections in a view layer."""

from __future__ import annotations

from collections.abc import Iterator

import bpy


def collections_in(place: bpy.types.LayerCollection) -> Iterator[bpy.types.LayerCollection]:
    """Yield all collections below one of a view layer, parents first: excluding one excludes those in it."""
    for child in place.children:
        yield child
        yield from collections_in(child)
