"""Channels of a character's rig that an animator may key: of bones, objects, custom properties and shape keys."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ...core.rigs.rig_map import LOCATION, PROPERTY, ROTATION, RigChannel
from ..characters import members_of
from ..meshes import mesh_of, posed_bones

_MECHANISM = ("DEF-", "ORG-", "MCH-", "VIS_")
"""Beginnings of the names of bones that Rigify and others do not mean for animators."""
_AXES = "xyz"
_MOST = 1e4
"""Range above which a property has none."""


def armatures_of(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the armatures that deform a head, or that drive its shape keys, by name."""
    found: set[bpy.types.Object] = set()
    for member in members_of(head):
        found |= {
            modifier.object
            for modifier in member.obj.modifiers
            if modifier.type == "ARMATURE" and modifier.object is not None
        }
    found |= {obj for obj in driving(head) if obj.type == "ARMATURE"}
    return sorted(found, key=lambda obj: obj.name)


def driving(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the objects whose values drive the shape keys of a head's meshes."""
    found: dict[bpy.types.Object, None] = {}
    for member in members_of(head):
        keys = mesh_of(member.obj).shape_keys
        for curve in () if keys is None or keys.animation_data is None else keys.animation_data.drivers:
            for variable in curve.driver.variables if curve.driver is not None else ():
                for target in variable.targets:
                    if isinstance(target.id, bpy.types.Object):
                        found[target.id] = None
    return list(found)


def channels_of(head: bpy.types.Object) -> list[RigChannel]:
    """Return the channels that may be keyed: visible, unlocked, not driven, and with room to move."""
    found: list[RigChannel] = []
    armatures = armatures_of(head)
    for armature in armatures:
        driven = _driven_paths(armature)
        for bone in posed_bones(armature):
            if _is_control(armature, bone):
                path = f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"]'
                found += _of_transform(armature, bone, path, driven)
                found += _of_properties(armature, bone, path, driven)
    for obj in driving(head):
        if obj not in armatures and obj.visible_get():
            found += _of_transform(obj, None, "", _driven_paths(obj))
            found += _of_properties(obj, None, "", _driven_paths(obj))
    return found


def _driven_paths(owner: bpy.types.Object) -> set[str]:
    """Return the data paths that drivers move, with the index of array elements."""
    curves = owner.animation_data.drivers if owner.animation_data is not None else ()
    return {f"{curve.data_path}[{curve.array_index}]" for curve in curves} | {curve.data_path for curve in curves}


def _is_control(armature: bpy.types.Object, bone: bpy.types.PoseBone) -> bool:
    """Return whether animators see a bone, and it is no part of the mechanism."""
    if bone.name.startswith(_MECHANISM) or bone.bone.hide or getattr(bone, "hide", False):
        return False
    collections = bone.bone.collections
    return not len(collections) or any(collection.is_visible_effectively for collection in collections)


def _of_transform(
    owner: bpy.types.Object, bone: bpy.types.PoseBone | None, path: str, driven: set[str]
) -> Iterator[RigChannel]:
    """Yield the channels of location, and of rotation, which may turn the jaw."""
    moved = owner if bone is None else bone
    dotted = f"{path}." if path else ""
    name = "" if bone is None else bone.name
    limits = _limits(moved)
    connected = bone is not None and bone.bone.use_connect and bone.parent is not None
    for axis in range(3):
        low, high = limits[axis]
        low, high = low - moved.location[axis], high - moved.location[axis]
        free = not moved.lock_location[axis] and f"{dotted}location[{axis}]" not in driven and not connected
        if free and low < high:
            yield RigChannel(owner.name, name, LOCATION, axis, low=min(low, 0.0), high=max(high, 0.0))
    turned = {f"{dotted}{kind}" for kind in ("rotation_euler", "rotation_quaternion", "rotation_axis_angle")}
    if bone is not None and not turned & driven and not any(moved.lock_rotation):
        for axis in range(3):
            yield RigChannel(owner.name, name, ROTATION, axis)


def _limits(moved: bpy.types.Object | bpy.types.PoseBone) -> list[tuple[float, float]]:
    """Return the least and greatest location on each axis, as constraints allow."""
    limits = [(-np.inf, np.inf)] * 3
    for constraint in moved.constraints:
        if constraint.type != "LIMIT_LOCATION" or constraint.mute or constraint.influence <= 0.0:
            continue
        if constraint.owner_space != ("LOCAL"):
            continue
        for axis, letter in enumerate(_AXES):
            low = getattr(constraint, f"min_{letter}") if getattr(constraint, f"use_min_{letter}") else -np.inf
            high = getattr(constraint, f"max_{letter}") if getattr(constraint, f"use_max_{letter}") else np.inf
            limits[axis] = max(limits[axis][0], low), min(limits[axis][1], high)
    return limits


def _of_properties(
    owner: bpy.types.Object, bone: bpy.types.PoseBone | None, path: str, driven: set[str]
) -> Iterator[RigChannel]:
    """Yield the channels of custom properties that are numbers with a range."""
    holder, bone_name = (owner, "") if bone is None else (bone, bone.name)
    for name in list(holder.keys()):
        value = holder[name]
        if not isinstance(value, float) or f'{path}["{bpy.utils.escape_identifier(name)}"]' in driven:
            continue
        shown = holder.id_properties_ui(name).as_dict()
        low, high = (float(shown.get(f"soft_{end}", shown[end])) - value for end in ("min", "max"))
        if high > low and max(-low, high) < _MOST:
            yield RigChannel(owner.name, bone_name, PROPERTY, name=name, low=min(low, 0.0), high=max(high, 0.0))
