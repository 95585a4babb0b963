"""The controls that were learnt, as they are stored with the object of a head."""

from __future__ import annotations

import base64
import binascii
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from ...core.errors import HeadError, SourceError
from ...core.rigs.few import ControlOrder
from ...core.rigs.rig_map import REGIONS, RigMap
from ...core.rigs.solver import share_shown
from ...core.rigs.storing import StoredControls, from_bytes, to_bytes
from ..meshes import mesh_of
from ..part_order import keep_order
from .finding import owners_of, require_animatable
from .fingerprint import NAMINGS, base_name, change_of, fingerprint


def write_controls(head: bpy.types.Object, found: RigMap) -> None:
    """Store a map with a head; raises HeadError as `require_storable`."""
    require_storable(head)
    keep_order(head)
    group, labels = rig_group(head), _labels(head)
    found = _labelled(found, {name: (name, label) for name, label in labels.items()})
    unused = {item.name for item in group.controls if not item.use}
    group.controls.clear()
    group.active, group.ranked = -1, ""
    order = list(REGIONS)
    for name, region in sorted(found.regions.items(), key=lambda item: order.index(item[1])):
        item = group.controls.add()
        item.name, item.region, item.use = name, region, name not in unused
    group.shown = share_shown(found)
    group.data = _encoded(head, found, labels)


def _encoded(head: bpy.types.Object, found: RigMap, labels: Mapping[str, str]) -> str:
    owners = [labels[obj.name] for obj in owners_of(head)]
    return base64.b64encode(to_bytes(found, fingerprint(head), owners)).decode()


def renew_stored() -> None:
    """Store the controls of the heads of the file as this version does, so that these can be renamed from now on."""
    for head in bpy.data.objects:
        if head.library is not None or head.override_library is not None or not has_controls(head):
            continue
        if (stored := _stored(head)) is not None and stored.earlier and not change_of(head, stored):
            rig_group(head).data = _encoded(head, _located(head, stored), _labels(head))


def _labels(head: bpy.types.Object) -> dict[str, str]:
    """Return the label of each object of a rig by its name: the one it had, or its name without Blender's number."""
    owners, stored = owners_of(head), _stored(head)
    found = {} if stored is None else {obj.name: label for label, obj in _owners(head, stored).items()}
    shared = Counter(map(base_name, owners))
    for obj in owners:
        if obj.name not in found:
            name = base_name(obj) if shared[base_name(obj)] == 1 else obj.name
            numbered = (name if number == 0 else f"{name} {number}" for number in range(len(owners) + 1))
            found[obj.name] = next(one for one in numbered if one not in found.values())
    return found


def require_storable(head: bpy.types.Object) -> None:
    """Raise HeadError if what is learnt cannot be stored with a head, as it is linked from another file."""
    require_animatable(head)
    if head.override_library is not None:
        raise HeadError(
            "{name} is a library override, with which its controls cannot be stored. Learn them in its own file, which "
            "then holds for all overrides, or make it local.",
            name=head.name,
        )


def write_order(head: bpy.types.Object, order: ControlOrder, name: str) -> None:
    """Store the order in which controls help to show the motion `name`; all of them stay in use."""
    group = rig_group(head)
    places: dict[str, tuple[int, float]] = {}
    for controls, error in zip(order.groups, order.errors, strict=True):
        places |= dict.fromkeys(controls, (len(places) + 1, error))
    for item in group.controls:
        item.order, item.error = places[item.name]
    group.ranked, group.few = name, len(group.controls)


def error_curve(head: bpy.types.Object) -> dict[int, float]:
    """Return the error with each number of controls, ascending; nothing if they were not ranked."""
    items = [item for item in rig_group(head).controls if item.order]
    return {sum(other.order <= item.order for other in items): item.error for item in sorted(items, key=_order)}


def _order(item: Any) -> int:
    return int(item.order)


def has_controls(head: bpy.types.Object) -> bool:
    """Return whether the controls of a head were learnt."""
    group = rig_group(head)
    return group is not None and bool(group.data)


def are_known(head: bpy.types.Object) -> bool:
    """Return whether the controls of a head were learnt, and its rig is as it was then."""
    return (stored := _stored(head)) is not None and not change_of(head, stored)


def stored_map(head: bpy.types.Object) -> RigMap | None:
    """Return all that was learnt, even if it is stale; None if nothing was, or it is damaged."""
    stored = _stored(head)
    return None if stored is None else _located(head, stored)


def read_controls(head: bpy.types.Object) -> RigMap:
    """Return what was learnt of the controls that are used.

    Raises HeadError if nothing was, no control is used, the rig has changed since, or it is linked from another file,
    and SourceError if what is stored is damaged.
    """
    if not has_controls(head):
        raise HeadError(
            "The controls of {name} are not known. Use Learn Controls in the Head panel first.", name=head.name
        )
    stored = _decoded(rig_group(head).data)
    if change := change_of(head, stored):
        raise HeadError(change)
    if stored.found.sample.max() >= len(mesh_of(head).vertices):
        raise SourceError(
            "The stored controls are damaged ({error}). Learn the controls again.", error="a vertex is missing"
        )
    owners = _owners(head, stored)
    for label in sorted(_used(stored.found)):
        require_animatable(owners[label])
    chosen = used_controls(head)
    if not chosen.channels:
        raise HeadError("No control of {name} is used. Enable some in Head > Controls.", name=head.name)
    return chosen


def used_controls(head: bpy.types.Object) -> RigMap:
    """Return what was learnt of the controls that are used, even if it is stale: the same object until others are.

    Raises SourceError if what is stored is damaged.
    """
    group = rig_group(head)
    unused = frozenset(item.name for item in group.controls if not item.use)
    return _chosen(group.data, unused, _names(head, _decoded(group.data)))


def controls_state(head: bpy.types.Object) -> tuple[bool, ...]:
    """Return what changes whenever other controls are used; takes microseconds."""
    group = rig_group(head)
    return () if group is None else tuple(item.use for item in group.controls)


def rig_group(head: bpy.types.Object) -> Any:
    """Return the properties of a head with its controls, a `FacemimeRig`; None if they are not registered."""
    return getattr(head, "facemime_rig", None)


def map_in(data: str) -> RigMap | None:
    """Return a map as it is stored, whose objects have labels as names; None if it is damaged."""
    try:
        return _decoded(data).found
    except SourceError:
        return None


def _stored(head: bpy.types.Object) -> StoredControls | None:
    """Return what is stored with a head; None if nothing is, or it is damaged."""
    try:
        return _decoded(rig_group(head).data) if has_controls(head) else None
    except SourceError:
        return None


def _owners(head: bpy.types.Object, stored: StoredControls) -> dict[str, bpy.types.Object]:
    """Return the objects of the rig of a head by their labels, without those that are no longer part of it.

    A rig that has changed, and one of a file of an earlier version, is known by the names of its objects.
    """
    present = owners_of(head)
    if len(stored.owners) == len(present):
        return dict(zip(stored.owners, present, strict=True))
    labels = stored.owners or tuple(dict.fromkeys(channel.owner for channel in stored.found.channels))
    found: list[dict[str, bpy.types.Object]] = []
    for naming in NAMINGS:
        named = {naming(obj): obj for obj in reversed(present)}
        found.append({label: named[label] for label in labels if label in named})
    return max(found, key=len)


def _names(head: bpy.types.Object, stored: StoredControls) -> frozenset[tuple[str, str]]:
    """Return labels of the objects of a rig, and their names."""
    return frozenset((label, obj.name) for label, obj in _owners(head, stored).items())


def _located(head: bpy.types.Object, stored: StoredControls) -> RigMap:
    """Return a map as it is stored, whose objects have the names that those of the rig of a head have now."""
    names = dict(_names(head, stored))
    return _labelled(stored.found, {label: (names.get(label, ""), label) for label in _used(stored.found)})


def _used(found: RigMap) -> set[str]:
    return {channel.owner for channel in found.channels}


def _labelled(found: RigMap, names: Mapping[str, tuple[str, str]]) -> RigMap:
    """Return a map whose objects have other names and labels, by their names."""
    channels = []
    for channel in found.channels:
        owner, label = names[channel.owner]
        channels.append(replace(channel, owner=owner, label=label))
    return replace(found, channels=tuple(channels))


@lru_cache(maxsize=8)
def _chosen(data: str, unused: frozenset[str], names: frozenset[tuple[str, str]]) -> RigMap:
    found, now = _decoded(data).found, dict(names)
    found = _labelled(found, {label: (now.get(label, ""), label) for label in _used(found)})
    return found.chosen(np.array([channel.control not in unused for channel in found.channels]))


@lru_cache(maxsize=4)
def _decoded(data: str) -> StoredControls:
    try:
        return from_bytes(base64.b64decode(data, validate=True))
    except (binascii.Error, UnicodeEncodeError) as error:
        raise SourceError(
            "The stored controls are damaged ({error}). Learn the controls again.", error=error
        ) from error
