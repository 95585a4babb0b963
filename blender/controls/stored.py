"""The controls that were learnt, as they are stored with the object of a head."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from ...core.errors import HeadError, SourceError
from ...core.rigs.few import ControlOrder
from ...core.rigs.rig_map import REGIONS, RigMap
from ...core.rigs.solver import share_shown
from ...core.rigs.storing import from_bytes, to_bytes
from ..characters import members_of
from ..fcurves import drivers_of
from ..meshes import mesh_of, posed_bones, read_places, rest_bones
from .finding import armatures_of

_DIGITS = 5
"""Decimals to which rest poses of bones and limits are the same."""


def write_controls(head: bpy.types.Object, found: RigMap) -> None:
    """Store a map with a head; raises HeadError as `require_storable`."""
    require_storable(head)
    group = rig_group(head)
    unused = {item.name for item in group.controls if not item.use}
    group.controls.clear()
    group.active, group.ranked = -1, ""
    order = list(REGIONS)
    for name, region in sorted(found.regions.items(), key=lambda item: order.index(item[1])):
        item = group.controls.add()
        item.name, item.region, item.use = name, region, name not in unused
    group.shown = share_shown(found)
    group.data = base64.b64encode(to_bytes(found, fingerprint(head))).decode()


def require_storable(head: bpy.types.Object) -> None:
    """Raise HeadError if what is learnt cannot be stored with a head, as it is linked from another file."""
    if head.library is not None:
        raise HeadError(
            "{name} is linked from another file and cannot be animated here. Make a library override of it "
            "(Object > Library Override > Make), or make it local.",
            name=head.name,
        )
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
    if stored_map(head) is None:
        return False
    return _decoded(rig_group(head).data)[1] == fingerprint(head)


def stored_map(head: bpy.types.Object) -> RigMap | None:
    """Return all that was learnt, even if it is stale; None if nothing was, or it is damaged."""
    try:
        return _decoded(rig_group(head).data)[0] if has_controls(head) else None
    except SourceError:
        return None


def read_controls(head: bpy.types.Object) -> RigMap:
    """Return what was learnt of the controls that are used.

    Raises HeadError if nothing was, no control is used, or the rig has changed since, and SourceError if what is stored
    is damaged.
    """
    if not has_controls(head):
        raise HeadError(
            "The controls of {name} are not known. Use Learn Controls in the Head panel first.", name=head.name
        )
    group = rig_group(head)
    found, known = _decoded(group.data)
    if known != fingerprint(head) or found.sample.max() >= len(mesh_of(head).vertices):
        raise HeadError(
            "The rig of {name} has changed since its controls were learnt. Learn the controls again.", name=head.name
        )
    chosen = used_controls(head)
    if not chosen.channels:
        raise HeadError("No control of {name} is used. Enable some in Head > Controls.", name=head.name)
    return chosen


def used_controls(head: bpy.types.Object) -> RigMap:
    """Return what was learnt of the controls that are used, even if it is stale: the same object until others are.

    Raises SourceError if what is stored is damaged.
    """
    group = rig_group(head)
    return _chosen(group.data, frozenset(item.name for item in group.controls if not item.use))


def controls_state(head: bpy.types.Object) -> tuple[bool, ...]:
    """Return what changes whenever other controls are used; takes microseconds."""
    group = rig_group(head)
    return () if group is None else tuple(item.use for item in group.controls)


def rig_group(head: bpy.types.Object) -> Any:
    """Return the properties of a head with its controls, a `FacemimeRig`; None if they are not registered."""
    return getattr(head, "facemime_rig", None)


@lru_cache(maxsize=8)
def _chosen(data: str, unused: frozenset[str]) -> RigMap:
    found = _decoded(data)[0]
    return found.chosen(np.array([channel.control not in unused for channel in found.channels]))


@lru_cache(maxsize=4)
def _decoded(data: str) -> tuple[RigMap, str]:
    try:
        return from_bytes(base64.b64decode(data, validate=True))
    except (binascii.Error, UnicodeEncodeError) as error:
        raise SourceError(
            "The stored controls are damaged ({error}). Learn the controls again.", error=error
        ) from error


def fingerprint(head: bpy.types.Object) -> str:
    """Return what changes if the bones, constraints, drivers or meshes of a character do; takes milliseconds."""
    digest = hashlib.sha256()
    for text in _description(head):
        digest.update(text.encode() + b"\0")
    return digest.hexdigest()


def _description(head: bpy.types.Object) -> Iterator[str]:
    yield str(read_places(head).tolist())
    for member in members_of(head):
        mesh = mesh_of(member.obj)
        yield f"{member.obj.name} {len(mesh.vertices)}"
        yield from (f"{modifier.type} {modifier.name}" for modifier in member.obj.modifiers)
        if mesh.shape_keys is not None:
            yield from _drivers(mesh.shape_keys)
    for armature in armatures_of(head):
        yield armature.name
        yield from _drivers(armature)
        for bone in rest_bones(armature):
            parent = "" if bone.parent is None else bone.parent.name
            yield f"{bone.name} {parent} {bone.use_connect} {_rounded(np.array(bone.matrix_local).ravel().tolist())}"
        for posed in posed_bones(armature):
            yield f"{posed.name} {posed.rotation_mode} {posed.lock_location[:]} {posed.lock_rotation[:]}"
            yield from (_constraint(constraint) for constraint in posed.constraints)


def _rounded(values: list[float]) -> list[float]:
    return [round(value, _DIGITS) + 0.0 for value in values]


def _drivers(owner: bpy.types.ID) -> list[str]:
    return [
        f"{curve.data_path} {curve.array_index} {curve.mute} {'' if curve.driver is None else curve.driver.expression}"
        for curve in drivers_of(owner)
    ]


def _constraint(constraint: bpy.types.Constraint) -> str:
    limits = [getattr(constraint, f"{end}_{axis}", 0.0) for end in ("min", "max") for axis in "xyz"]
    return f"{constraint.type} {constraint.name} {constraint.mute} {_rounded([constraint.influence, *limits])}"
