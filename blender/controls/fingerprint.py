"""Whether a rig is still as it was when its controls were learnt.

What its objects are called does not count, so that controls also serve a copy of the character, a library override of
it, and a character that was renamed.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping

import bpy
import numpy as np

from ...core.errors import Message
from ...core.rigs.storing import RigPart, StoredControls
from ..characters import library_name, members_of
from ..fcurves import drivers_of
from ..meshes import mesh_of, posed_bones, read_places, rest_bones
from ..switching import driver_mutes
from .finding import owners_of

Naming = Callable[[bpy.types.Object], str]

_BONE, _DRIVERS, _MESH, _FACE = "bone", "drivers", "mesh", "face"
"""Kinds of parts of a rig."""
_DIGITS = 5
"""Decimals to which rest poses of bones and limits are the same."""
_LENGTH = 12
"""Hexadecimal digits of a part's fingerprint; a changed part has the same with a probability of 1 in 2^48."""


def fingerprint(head: bpy.types.Object) -> dict[RigPart, str]:
    """Return what changes if the bones, constraints, drivers or meshes of a character do; takes milliseconds.

    Bones and drivers have the number of their object in `owners_of`, and meshes that in `members_of`.
    """
    parts: dict[RigPart, list[str]] = {(_FACE, 0, ""): [str(read_places(head).tolist())]}
    for number, member in enumerate(members_of(head)):
        parts[_MESH, number, ""] = _mesh(member.obj)
    for number, owner in enumerate(owners_of(head)):
        if owner.type == "ARMATURE":
            parts[_DRIVERS, number, ""] = _drivers(owner)
            posed = posed_bones(owner)
            for bone in rest_bones(owner):
                parts[_BONE, number, bone.name] = [
                    _rest(bone),
                    *(_posed(posed[bone.name]) if bone.name in posed else ()),
                ]
    return {part: _digest(texts)[:_LENGTH] for part, texts in parts.items()}


def change_of(head: bpy.types.Object, stored: StoredControls) -> str:
    """Return what has changed about the rig of a head since its controls were learnt, in a sentence; "" if nothing."""
    if stored.earlier:
        same = any(_earlier_fingerprint(head, naming) == stored.earlier for naming in NAMINGS)
        return "" if same else _changed(head)
    now = fingerprint(head)
    if now == stored.rig:
        return ""
    return _named_change(head, stored, now) or _changed(head)


def _changed(head: bpy.types.Object) -> str:
    return Message(
        "The rig of {name} has changed since its controls were learnt. Learn the controls again.", name=head.name
    )


def _named_change(head: bpy.types.Object, stored: StoredControls, now: Mapping[RigPart, str]) -> str:
    """Name a bone that is missing, or the only part that is different; "" if there are several."""
    owners = [obj.name for obj in owners_of(head)]
    missing = [part for part in stored.rig if part not in now]
    changed = [part for part in now if stored.rig.get(part) != now[part]]
    values = {"name": head.name}
    for kind, number, bone in missing:
        if kind == _BONE and number < len(owners) and (_DRIVERS, number, "") in now:
            return Message(
                "The bone {bone} of {rig} was removed or renamed after the controls of {name} were learnt. Restore it, "
                "or learn the controls again.",
                bone=bone,
                rig=owners[number],
                **values,
            )
    if missing or len(changed) != 1:
        return ""
    kind, number, bone = changed[0]
    if kind == _BONE:
        return Message(
            "The bone {bone} of {rig} was added or changed after the controls of {name} were learnt. Learn the "
            "controls again.",
            bone=bone,
            rig=owners[number],
            **values,
        )
    if kind == _MESH:
        return Message(
            "The vertices, modifiers or drivers of {mesh} have changed since the controls of {name} were learnt. Learn "
            "the controls again.",
            mesh=members_of(head)[number].obj.name,
            **values,
        )
    return ""


def base_name(obj: bpy.types.Object) -> str:
    """Return the name of an object without the number that Blender gives to copies."""
    return re.sub(r"\.\d{3,}$", "", library_name(obj))


def _own_name(obj: bpy.types.Object) -> str:
    return obj.name


NAMINGS: tuple[Naming, ...] = (_own_name, library_name, base_name)
"""Names by which files of earlier versions may know an object: its own, that in its library, that of its original."""


def _earlier_fingerprint(head: bpy.types.Object, naming: Naming) -> str:
    """Return the fingerprint as earlier versions stored it, with the names of objects."""
    texts = [str(read_places(head).tolist())]
    first, *others = (member.obj for member in members_of(head))
    for obj in (first, *sorted(others, key=naming)):
        counted, *rest = _mesh(obj)
        texts += [f"{naming(obj)} {counted}", *rest]
    for armature in sorted((obj for obj in owners_of(head) if obj.type == "ARMATURE"), key=naming):
        texts += [naming(armature), *_drivers(armature), *map(_rest, rest_bones(armature))]
        texts += [text for posed in posed_bones(armature) for text in _posed(posed)]
    return _digest(texts)


def _digest(texts: list[str]) -> str:
    return hashlib.sha256(b"".join(text.encode() + b"\0" for text in texts)).hexdigest()


def _mesh(obj: bpy.types.Object) -> list[str]:
    mesh = mesh_of(obj)
    modifiers = [f"{modifier.type} {modifier.name}" for modifier in obj.modifiers]
    return [str(len(mesh.vertices)), *modifiers, *([] if mesh.shape_keys is None else _drivers(mesh.shape_keys))]


def _rest(bone: bpy.types.Bone) -> str:
    parent = "" if bone.parent is None else bone.parent.name
    return f"{bone.name} {parent} {bone.use_connect} {_rounded(np.array(bone.matrix_local).ravel().tolist())}"


def _posed(posed: bpy.types.PoseBone) -> Iterator[str]:
    yield f"{posed.name} {posed.rotation_mode} {posed.lock_location[:]} {posed.lock_rotation[:]}"
    yield from (_constraint(constraint) for constraint in posed.constraints)


def _rounded(values: list[float]) -> list[float]:
    return [round(value, _DIGITS) + 0.0 for value in values]


def _drivers(owner: bpy.types.ID) -> list[str]:
    mutes = driver_mutes(owner)
    return [
        f"{curve.data_path} {curve.array_index} {mutes[curve.data_path, curve.array_index]} "
        f"{'' if curve.driver is None else curve.driver.expression}"
        for curve in drivers_of(owner)
    ]


def _constraint(constraint: bpy.types.Constraint) -> str:
    limits = [getattr(constraint, f"{end}_{axis}", 0.0) for end in ("min", "max") for axis in "xyz"]
    return f"{constraint.type} {constraint.name} {constraint.mute} {_rounded([constraint.influence, *limits])}"
