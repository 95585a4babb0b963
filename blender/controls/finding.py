"""Channels of a character's rig that an animator may key: of bones, objects, custom properties and shape keys."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from ...core.errors import HeadError
from ...core.face.landmarks import OUTER_EYE_CORNERS
from ...core.rigs.rig_map import LOCATION, PROPERTY, ROTATION, SCALE, RigChannel
from ..characters import members_of, parent_matrix, read_bones
from ..eye_bones import aim_of
from ..fcurves import drivers_of
from ..meshes import armature_data, mesh_of, posed_bones, read_places, read_vertices
from ..own_pose import ROTATIONS
from ..own_pose import path_of as prefix_in_path

_MECHANISM = ("DEF-", "ORG-", "MCH-", "VIS_")
"""Beginnings of the names of bones that Rigify and others do not mean for animators."""
_AXES = "xyz"
_BONE = re.compile(r'pose\.bones\["((?:[^"\\]|\\.)*)"\]')
"""Beginning of the data path of a bone's property."""
_MOST = 1e4
"""Range above which a property has none."""


def owners_of(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the objects of the rig of a head: those that deform its meshes, and then those that drive them.

    They come in the order in which the character uses them, which is the same on a copy, whatever their names are.
    """
    deforming = _deforming(_meshes(head))
    return list(dict.fromkeys([*deforming, *(obj for obj, _ in _driving(head, deforming))]))


def driving_controls(head: bpy.types.Object) -> set[tuple[str, str]]:
    """Return the objects and bones whose values drive shape keys or the armatures of a head: names, "" for no bone."""
    found = set()
    for obj, target in _driving(head, _deforming(_meshes(head))):
        named = _BONE.match(target.data_path)
        bone = target.bone_target or ("" if named is None else bpy.utils.unescape_identifier(named[1]))
        found.add((obj.name, bone))
    return found


def require_animatable(obj: bpy.types.Object) -> None:
    """Raise HeadError if an object of a rig is linked from another file."""
    if obj.library is not None:
        raise HeadError(
            "{name} is linked from another file and cannot be animated here. Make a library override of it "
            "(Object > Library Override > Make), or make it local.",
            name=obj.name,
        )


def armatures_of(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the armatures that deform a head, or that drive its shape keys, in the order of `owners_of`."""
    return [obj for obj in owners_of(head) if obj.type == "ARMATURE"]


def _deforming(meshes: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    modifiers = [modifier for obj in meshes for modifier in obj.modifiers]
    found = [modifier.object for modifier in modifiers if isinstance(modifier, bpy.types.ArmatureModifier)]
    return list(dict.fromkeys(obj for obj in found if obj is not None))


def _driving(
    head: bpy.types.Object, deforming: Sequence[bpy.types.Object]
) -> Iterator[tuple[bpy.types.Object, bpy.types.DriverTarget]]:
    """Yield the objects whose values drive the shape keys or armatures of a head, and which value it is."""
    keys = [block for block in (mesh_of(obj).shape_keys for obj in _meshes(head)) if block is not None]
    for owner in (*keys, *deforming):
        for curve in sorted(drivers_of(owner), key=lambda curve: (curve.data_path, curve.array_index)):
            for variable in curve.driver.variables if curve.driver is not None else ():
                for target in variable.targets:
                    if isinstance(target.id, bpy.types.Object):
                        yield target.id, target


def channels_of(head: bpy.types.Object) -> list[RigChannel]:
    """Return the channels that may be keyed: visible, unlocked, not driven, and with room to move.

    Raises HeadError if a rig is linked from another file.
    """
    bpy.context.view_layer.update()  # scripts may just have scaled an armature
    found: list[RigChannel] = []
    owners = owners_of(head)
    armatures = [obj for obj in owners if obj.type == "ARMATURE"]
    sliders = [obj for obj in owners if obj not in armatures and obj.visible_get()]
    for obj in (*armatures, *sliders):
        require_animatable(obj)
    posed, bones = read_bones(head)
    posing = {bones.head, bones.eye_left, bones.eye_right}
    if posed is not None:
        aims = [aim_of(posed, eye, bones.head) for eye in (bones.eye_left, bones.eye_right) if eye]
        posing |= {aim.bone for aim in aims if aim is not None}
    for armature in armatures:
        driven = _driven_paths(armature)
        for bone in posed_bones(armature):
            if _is_control(bone) and bone.name not in posing:
                found += _of_transform(head, armature, bone, driven)
                found += _of_properties(armature, bone, driven)
        found += _of_properties(armature, None, driven)
    for obj in sliders:
        driven = _driven_paths(obj)
        found += _of_transform(head, obj, None, driven) if obj.type != "MESH" or obj not in _meshes(head) else ()
        found += _of_properties(obj, None, driven)
    return found


def is_resting(obj: bpy.types.Object) -> bool:
    """Return whether an object is an armature in Rest Position, whose bones move nothing."""
    return obj.type == "ARMATURE" and armature_data(obj).pose_position == "REST"


def require_deforming(head: bpy.types.Object) -> None:
    """Raise HeadError if the armatures of a head are set up so that their bones do not move it."""
    for armature in filter(is_resting, _deforming([head])):
        raise HeadError(
            "{name} is in Rest Position, which hides the pose of its bones. "
            "Set it to Pose Position in the Armature tab.",
            name=armature.name,
        )
    modifiers = [modifier for modifier in head.modifiers if isinstance(modifier, bpy.types.ArmatureModifier)]
    deforming = [modifier for modifier in modifiers if modifier.object is not None]
    if deforming and not any(modifier.show_viewport for modifier in deforming):
        raise HeadError(
            "The modifier {modifier} of {name} is disabled in viewports, so that bones do not move the face. Enable "
            "it, and try again.",
            modifier=deforming[0].name,
            name=head.name,
        )


def eye_distance_of(head: bpy.types.Object) -> float:
    """Return the outer-eye distance of a head in the unit of its mesh."""
    points = read_vertices(mesh_of(head))[read_places(head)]
    return float(np.linalg.norm(np.subtract(*points[OUTER_EYE_CORNERS])))


def _meshes(head: bpy.types.Object) -> list[bpy.types.Object]:
    return [member.obj for member in members_of(head)]


def path_of(channel: RigChannel, mode: str = "") -> str:
    """Return the data path of a channel; of a rotation, that of a control with this rotation mode."""
    bone = f'pose.bones["{bpy.utils.escape_identifier(channel.bone)}"]' if channel.bone else ""
    if channel.kind == PROPERTY:
        return f'{bone}["{bpy.utils.escape_identifier(channel.name)}"]'
    name = ROTATIONS.get(mode, "rotation_euler") if channel.kind == ROTATION else channel.kind
    return f"{bone}.{name}" if bone else name


def rotation_of(mode: str) -> str:
    """Return the name of the property with the rotation in a mode."""
    return {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}.get(mode, "rotation_euler")


def _driven_paths(owner: bpy.types.Object) -> set[str]:
    """Return the data paths that drivers move, with and without the index of array elements."""
    return {
        path for curve in drivers_of(owner) for path in (f"{curve.data_path}[{curve.array_index}]", curve.data_path)
    }


def _is_control(bone: bpy.types.PoseBone) -> bool:
    """Return whether animators see a bone, and it is no part of the mechanism."""
    if bone.name.startswith(_MECHANISM) or bone.bone.hide or getattr(bone, "hide", False):
        return False
    collections = bone.bone.collections
    return not len(collections) or any(collection.is_visible_effectively for collection in collections)


def _of_transform(
    head: bpy.types.Object, owner: bpy.types.Object, bone: bpy.types.PoseBone | None, driven: set[str]
) -> Iterator[RigChannel]:
    """Yield the channels of location, of rotation, which may turn the jaw, and of scale, which may shape the lips."""
    moved = owner if bone is None else bone
    dotted, name = ("", "") if bone is None else (prefix_in_path(bone), bone.name)
    space = owner.matrix_world if bone is not None else parent_matrix(owner)
    unit = eye_distance_of(head) * head.matrix_world.median_scale / max(space.median_scale, 1e-12)
    connected = bone is not None and bone.bone.use_connect and bone.parent is not None
    places, turns, sizes = (_limits(moved, f"LIMIT_{kind}") for kind in ("LOCATION", "ROTATION", "SCALE"))
    for axis, (low, high) in enumerate(places):
        # Bones rest in their rest pose, sliders where they are.
        rest = 0.0 if bone is not None else moved.location[axis]
        free = not moved.lock_location[axis] and f"{dotted}location[{axis}]" not in driven and not connected
        if free and low < high:
            down, up = min(low - rest, 0.0), max(high - rest, 0.0)
            yield RigChannel(owner.name, name, LOCATION, axis, low=down, high=up, rest=rest, unit=unit)
    turned = {f"{dotted}{kind}" for kind in ("rotation_euler", *ROTATIONS.values())}
    if bone is not None and not turned & driven and not (moved.lock_rotations_4d and moved.lock_rotation_w):
        for axis, (low, high) in enumerate(turns):
            if low < high and not moved.lock_rotation[axis]:
                yield RigChannel(owner.name, name, ROTATION, axis, low=min(low, 0.0), high=max(high, 0.0))
    for axis, (low, high) in enumerate(sizes if bone is not None else ()):
        if not moved.lock_scale[axis] and f"{dotted}scale[{axis}]" not in driven and low < high:
            down, up = min(low - 1.0, 0.0), max(high - 1.0, 0.0)
            yield RigChannel(owner.name, name, SCALE, axis, low=down, high=up, rest=1.0)


def _limits(moved: bpy.types.Object | bpy.types.PoseBone, kind: str) -> list[tuple[float, float]]:
    """Return the least and greatest value on each axis that constraints of a kind allow."""
    limits = [(-np.inf, np.inf)] * 3
    # An object without a parent moves in the world, which is the space of a new constraint.
    spaces = {"LOCAL", "WORLD"} if isinstance(moved, bpy.types.Object) and moved.parent is None else {"LOCAL"}
    for constraint in moved.constraints:
        if constraint.type != kind or constraint.mute or constraint.influence <= 0.0:
            continue
        if constraint.owner_space not in spaces:
            continue
        for axis, letter in enumerate(_AXES):
            if kind == "LIMIT_ROTATION":
                sides = [getattr(constraint, f"use_limit_{letter}")] * 2
            else:
                sides = [getattr(constraint, f"use_{end}_{letter}") for end in ("min", "max")]
            low = getattr(constraint, f"min_{letter}") if sides[0] else -np.inf
            high = getattr(constraint, f"max_{letter}") if sides[1] else np.inf
            limits[axis] = max(limits[axis][0], low), min(limits[axis][1], high)
    return limits


def _of_properties(owner: bpy.types.Object, bone: bpy.types.PoseBone | None, driven: set[str]) -> Iterator[RigChannel]:
    """Yield the channels of custom properties that are real numbers with a range."""
    holder, bone_name = (owner, "") if bone is None else (bone, bone.name)
    for name in list(holder.keys()):
        value = holder[name]
        channel = RigChannel(owner.name, bone_name, PROPERTY, name=name)
        if not isinstance(value, float) or path_of(channel) in driven:
            continue
        shown: dict[str, Any] = holder.id_properties_ui(name).as_dict()  # type: ignore[attr-defined]  # its stub is empty
        low, high = (float(shown.get(f"soft_{end}", shown[end])) - value for end in ("min", "max"))
        if high > low and max(-low, high) < _MOST:
            yield replace(channel, low=min(low, 0.0), high=max(high, 0.0), rest=value)
