"""Parts that follow their head: eyes, teeth and tongue are deleted, hidden, linked and duplicated with it.

The head points to its parts, so that Blender appends and links them with it, and a driver hides each part in renders
while its head is hidden there; it also tells a part whose head was deleted from one that was unparented.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import bpy

from ..characters import parts_of
from ..fcurves import drivers_of
from ..meshes import mesh_of
from ..names import PART_PROPERTY, PARTS_PROPERTY

_HIDDEN = "hide_render"


@dataclass(frozen=True)
class Unfinished:
    """Changes to parts that are pending after heads were deleted, linked or duplicated.

    Attributes
    ----------
    orphans : tuple of bpy.types.Object
        Parts whose head was deleted.
    shared : tuple of (bpy.types.Object, str, bpy.types.Object)
        Head, key and part of each part that belongs to another head, from which this one was duplicated.
    absent : tuple of (bpy.types.Object, str, bpy.types.Object)
        Those of each part that is in no scene, although its head is.
    """

    orphans: tuple[bpy.types.Object, ...] = ()
    shared: tuple[tuple[bpy.types.Object, str, bpy.types.Object], ...] = ()
    absent: tuple[tuple[bpy.types.Object, str, bpy.types.Object], ...] = ()

    def __bool__(self) -> bool:
        return bool(self.orphans or self.shared or self.absent)

    @property
    def summary(self) -> tuple[int, ...]:
        """A key that identifies the same state, even after an undo."""
        others = [obj for head, _, part in (*self.shared, *self.absent) for obj in (head, part)]
        return tuple(obj.session_uid for obj in (*self.orphans, *others))


def attach(head: bpy.types.Object, parts: Mapping[str, bpy.types.Object]) -> None:
    """Attach to a head its parts, which are children of it, by a key of `names.PART_OBJECTS`."""
    head[PARTS_PROPERTY] = dict(parts)
    for part in parts.values():
        _follow(part, head)


def attach_all() -> None:
    """Attach the parts of heads that have none attached, such as those in files from earlier versions."""
    found: dict[bpy.types.Object, dict[str, bpy.types.Object]] = {}
    attached = {part for head in heads_with_parts() for part in parts_of(head).values()}
    for obj in bpy.data.objects:
        head = obj.parent if PART_PROPERTY in obj and obj not in attached else None  # the user may have rigged them
        if (
            head is not None
            and head.type == "MESH"
            and _is_local(head)
            and _is_local(obj)
            and PARTS_PROPERTY not in head
        ):
            found.setdefault(head, {})[str(obj[PART_PROPERTY])] = obj
    for head, parts in found.items():
        attach(head, parts)


def heads_with_parts() -> list[bpy.types.Object]:
    """Return the objects of the file to which parts are attached."""
    return [obj for obj in bpy.data.objects if PARTS_PROPERTY in obj]


def unfinished() -> Unfinished:
    """Return the changes to parts that are pending after heads were deleted, linked or duplicated."""
    parts = [obj for obj in bpy.data.objects if PART_PROPERTY in obj]
    if not parts:
        return Unfinished()
    placed = {obj for scene in bpy.data.scenes for obj in scene.objects}
    orphans = [part for part in parts if part.is_editable and _is_orphan(part, placed)]
    claims = [(head, key, part) for head in heads_with_parts() for key, part in parts_of(head).items()]
    claims = [claim for claim in claims if claim[2] not in orphans]
    owners = {part: _owner(part, [head for head, _, other in claims if other == part]) for *_, part in claims}
    shared = [(head, key, part) for head, key, part in claims if owners[part] != head and head.is_editable]
    absent = [claim for claim in claims if owners[claim[2]] == claim[0] in placed and claim[2] not in placed]
    return Unfinished(tuple(orphans), tuple(shared), tuple(absent))


def finish(left: Unfinished, known: set[int]) -> None:
    """Delete orphans, copy the parts of duplicated heads, and add the parts of linked heads to their collections.

    `known` has the `session_uid` of heads that were there before; absent parts of these were deleted by the user.
    """
    gone = list(left.orphans)
    for head, key, part in left.absent:
        if head.session_uid not in known:
            _put_beside(part, head)
        elif part.is_editable:
            del head[PARTS_PROPERTY][key]
            gone.append(part)
    for head, key, part in left.shared:
        head[PARTS_PROPERTY][key] = _copy(part, head)
    bpy.data.batch_remove(gone)


def hide_with_heads(layer: bpy.types.ViewLayer, hidden: Mapping[int, bool]) -> dict[int, bool]:
    """Hide parts with their heads in a view layer, and show them with those that are no longer hidden.

    Returns whether each head is hidden, by its `session_uid`.
    """
    heads = heads_with_parts()
    now = hidden_heads(layer)
    within = set(layer.objects) if heads else set()
    for head in heads:
        hide, before = now[head.session_uid], hidden.get(head.session_uid, False)
        for part in parts_of(head).values() if hide or before else ():
            if part in within and part.hide_get(view_layer=layer) != hide:
                part.hide_set(hide, view_layer=layer)
    return now


def hidden_heads(layer: bpy.types.ViewLayer) -> dict[int, bool]:
    """Return whether each head is hidden in a view layer, by its `session_uid`."""
    return {head.session_uid: head.hide_viewport or head.hide_get(view_layer=layer) for head in heads_with_parts()}


def _is_local(obj: bpy.types.Object) -> bool:
    """Return whether an object is the file's own: neither linked nor a library override."""
    return obj.library is None and obj.override_library is None


def _follow(part: bpy.types.Object, head: bpy.types.Object) -> None:
    """Hide a part in renders while its head is hidden there, by a driver that runs no script."""
    part.driver_remove(_HIDDEN)
    curve = part.driver_add(_HIDDEN)
    assert isinstance(curve, bpy.types.FCurve), "the property is not an array"
    driver = curve.driver
    assert driver is not None
    driver.type = "AVERAGE"
    target = driver.variables.new().targets[0]
    target.id, target.data_path = head, _HIDDEN


def _followed(part: bpy.types.Object) -> Iterator[bpy.types.Object | None]:
    """Yield the head that the driver of a part refers to; None if it was deleted."""
    for curve in drivers_of(part):
        driver = curve.driver
        if curve.data_path == _HIDDEN and driver is not None and len(driver.variables) == 1:
            target = driver.variables[0].targets[0]
            if target.data_path == _HIDDEN:
                yield target.id if isinstance(target.id, bpy.types.Object) else None


def _is_orphan(part: bpy.types.Object, placed: set[bpy.types.Object]) -> bool:
    return any(head is None or (head not in placed and part in placed) for head in _followed(part))


def _owner(part: bpy.types.Object, heads: list[bpy.types.Object]) -> bpy.types.Object:
    """Return the head to which a part belongs: its parent, or the oldest one."""
    return part.parent if part.parent in heads else min(heads, key=lambda head: head.session_uid)


def _copy(part: bpy.types.Object, head: bpy.types.Object) -> bpy.types.Object:
    """Copy a part for a duplicate of its head; they share the mesh if the heads do."""
    other = part.copy()
    if part.parent is None or part.parent.data != head.data:
        other.data = mesh_of(part).copy()
    if part.parent is not None and PARTS_PROPERTY in part.parent:
        other.parent = head
    _follow(other, head)
    _put_beside(other, head)
    return other


def _put_beside(part: bpy.types.Object, head: bpy.types.Object) -> None:
    """Put a part into the collections of a head."""
    for collection in head.users_collection:
        # Blender does not let objects be added to an override of a collection.
        free = collection.is_editable and collection.override_library is None
        if free and part.name not in collection.objects:
            collection.objects.link(part)
