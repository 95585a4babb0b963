"""The examples by which a head was taught, as they are stored with its object."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import bpy

from ..core.errors import HeadError, SourceError
from ..core.heads.style import MAX_EXAMPLES, Example, Style, style_bytes, style_of
from .characters import members_of
from .meshes import key_names
from .part_order import keep_order


def read_style(obj: bpy.types.Object) -> Style:
    """Return the examples of a head; raises SourceError if one is damaged."""
    return Style(tuple(read_example(item) for item in _items(obj)))


def has_examples(obj: bpy.types.Object) -> bool:
    """Return whether a head was taught by examples."""
    return len(_items(obj)) > 0


def style_state(obj: bpy.types.Object) -> tuple[object, ...]:
    """Return what changes whenever the examples of a head act differently; takes microseconds."""
    return tuple((item.key, item.weight, item.mute) for item in _items(obj))


def read_example(item: Any) -> Example:
    """Return an example of the list of a head; raises SourceError if it is damaged."""
    try:
        stored = _decoded(item.data)
    except (ValueError, binascii.Error) as error:
        raise SourceError(
            "The example {name} is damaged ({error}). Remove it, and teach its frame again.",
            name=item.name,
            error=error,
        ) from error
    return replace(stored, name=item.name, performer=item.performer, weight=item.weight, muted=item.mute)


def write_example(obj: bpy.types.Object, example: Example, place: int | None = None) -> None:
    """Store an example with a head, at the end of its list or instead of the one at `place`, and select it.

    Raises HeadError if the object is linked from another file, or has too many examples.
    """
    _require_own(obj)
    keep_order(obj)
    group = style_group(obj)
    if place is None and len(group.examples) >= MAX_EXAMPLES:
        raise HeadError(
            "{name} has {count} examples already, which is the largest number. Remove one first.",
            name=obj.name,
            count=MAX_EXAMPLES,
        )
    item = group.examples.add() if place is None else group.examples[place]
    data = style_bytes(Style((example,)))
    if place is None:
        item.name = _free(example.name, [other.name for other in group.examples])
    item.performer, item.weight, item.mute = example.performer, example.weight, example.muted
    item.data, item.key = base64.b64encode(data).decode("ascii"), hashlib.sha1(data).hexdigest()
    group.example = len(group.examples) - 1 if place is None else place


def add_style(obj: bpy.types.Object, style: Style, count: int) -> None:
    """Add examples to those of a head with `count` vertices.

    Raises HeadError if one was taught on another mesh and by no shape key of this head, or as `write_example`.
    """
    names = [name for member in members_of(obj) for name in key_names(member.obj)]
    for example in style.fitted_to(count, names).examples:
        write_example(obj, example)


def remove_example(obj: bpy.types.Object, place: int) -> None:
    """Remove an example of a head; raises HeadError if the object is linked from another file."""
    _require_own(obj)
    group = style_group(obj)
    group.examples.remove(place)
    group.example = max(0, min(place, len(group.examples) - 1))


def _items(obj: bpy.types.Object) -> Sequence[Any]:
    return getattr(style_group(obj), "examples", ())


def style_group(obj: bpy.types.Object) -> Any:
    """Return the properties of a head with its examples, a `FacemimeStyle`; None if they are not registered."""
    return getattr(obj, "facemime_style", None)


@lru_cache(maxsize=2 * MAX_EXAMPLES)
def _decoded(data: str) -> Example:
    (example,) = style_of(base64.b64decode(data)).examples
    return example


def _free(name: str, taken: Sequence[str]) -> str:
    numbered = (name if number == 1 else f"{name} {number}" for number in range(1, len(taken) + 2))
    return next(one for one in numbered if one not in taken)


def _require_own(obj: bpy.types.Object) -> None:
    if obj.library is not None:
        raise HeadError(
            "{name} is linked from another file, so its examples cannot be changed here. "
            "Make it local: Object > Relations > Make Local.",
            name=obj.name,
        )
