"""A neck for characters without bones: a bone that turns the head while the body stays where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

from ...core.errors import Message
from ...core.face.landmarks import JAW, outer_eye_distance
from ...core.heads.part_names import FaceBones
from ...core.heads.rig import neck_of
from ...core.numeric.arrays import FloatArray
from ..characters import objects_of, places_in, read_bones, rest_matrix, write_bones
from ..frames import from_blender, to_blender
from ..meshes import armature_data, is_head, mesh_of, read_landmarks, read_vertices, rest_bones
from ..names import NECK_PROPERTY
from ..view_layers import select_alone
from .family import armature_of, family_of

_NAMES = "Head", "Body"
"""Bones, numbered where a mesh has a vertex group of that name. The second never moves: Blender scales the weights of a
vertex so that they add up to 1."""
_BELOW_CHIN = (0.05, 0.8)
"""Heights below the chin, in outer-eye distances, between which the head passes into the body: a neck is about as long.
"""
_BESIDE = (3.0, 4.0)
"""Distances from the neck's axis, in outer-eye distances, between which the head ends: hair and hats are within, raised
hands beyond."""
_BODY = 2.5
"""Distance below the chin, in outer-eye distances, from which a character has a body; busts turn as a whole."""
_NEAR = 0.2
"""Distance, in outer-eye distances, within which the bone fits a face that was found again."""
_STEPS = 64
"""Number of different weights, as Blender takes a call for each."""


def give_neck(head: bpy.types.Object) -> str:
    """Add a bone that turns the head of a character that has a body and no bones, and say so; "" if it needs none.

    It moves all meshes of the character, with weights that end in the neck. One that was added for a face elsewhere is
    replaced. `head` has to be visible.
    """
    if not head.visible_get() or not is_head(head):
        return ""
    points = read_vertices(mesh_of(head))[read_landmarks(head)].astype(np.float64)
    if (former := armature_of(head)) is not None:
        if NECK_PROPERTY not in former or _off(former, head, points) < _NEAR:
            return ""
        remove_neck(former)
    unit, meshes = outer_eye_distance(points), dict.fromkeys([head, *family_of(head), *objects_of(head)])
    places = {obj: places_in(head, obj) for obj in meshes if obj.is_editable and mesh_of(obj).is_editable}
    if max(float(of[:, 1].max()) for of in places.values()) < points[JAW, 1].max() + _BODY * unit:
        return ""
    shares = {obj: share for obj, of in places.items() if (share := _shares(of, points)).any()}
    taken = {group.name for obj in shares for group in obj.vertex_groups}
    bones = [
        next(free for free in (name, *(f"{name}.{n:03d}" for n in range(1, 999))) if free not in taken)
        for name in _NAMES
    ]
    armature = _armature(head, bones, neck_of(points), unit)
    _deform(shares, bones, armature)
    write_bones(head, armature, replace(read_bones(head)[1], head=bones[0]))
    return Message("{name} turns the head, so that the body stays still", name=armature.name)


def remove_neck(armature: bpy.types.Object) -> None:
    """Remove an armature that `give_neck` added."""
    bones = [bone.name for bone in rest_bones(armature)]
    for obj in [obj for obj in bpy.data.objects if obj.type == "MESH" and obj.find_armature() == armature]:
        for modifier in [modifier for modifier in obj.modifiers if getattr(modifier, "object", None) == armature]:
            obj.modifiers.remove(modifier)
        for group in [group for group in obj.vertex_groups if group.name in bones]:
            obj.vertex_groups.remove(group)
        if obj.parent == armature:
            world = obj.matrix_world.copy()
            obj.parent = armature.parent
            obj.matrix_world = world
        if read_bones(obj)[0] == armature:
            write_bones(obj, None, FaceBones())
    bpy.data.armatures.remove(armature_data(armature))


def _off(armature: bpy.types.Object, head: bpy.types.Object, points: FloatArray) -> float:
    """Return how far the bone of `armature` is from the neck, in outer-eye distances."""
    turning = next(bone for bone in rest_bones(armature) if bone.parent is not None)
    bone = rest_matrix(armature) @ turning.head_local
    local = from_blender(np.array(rest_matrix(head).inverted_safe() @ bone))
    return float(np.linalg.norm(local - neck_of(points))) / outer_eye_distance(points)


def _shares(places: FloatArray, points: FloatArray) -> FloatArray:
    """Return the share (V,) of the motion of a head with landmarks `points` (66, 3) that vertices follow, in steps."""
    unit, (middle_x, _, middle_z) = outer_eye_distance(points), neck_of(points)
    below = (places[:, 1] - points[JAW, 1].max()) / unit
    beside = np.hypot(places[:, 0] - middle_x, places[:, 2] - middle_z) / unit
    return np.asarray(np.round(_STEPS * _fade(below, *_BELOW_CHIN) * _fade(beside, *_BESIDE)) / _STEPS)


def _fade(values: FloatArray, begin: float, end: float) -> FloatArray:
    """From 1 at `begin` smoothly to 0 at `end`."""
    share = np.clip((end - values) / (end - begin), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _armature(head: bpy.types.Object, names: Sequence[str], pivot: FloatArray, unit: float) -> bpy.types.Object:
    """Add an armature with two bones that meet at `pivot` (3,), in the head frame, in the place of `head`."""
    armature = bpy.data.objects.new(f"{head.name} Neck", bpy.data.armatures.new(f"{head.name} Neck"))
    armature[NECK_PROPERTY] = True
    for collection in head.users_collection:
        collection.objects.link(armature)
    armature.parent = head.parent
    bpy.context.view_layer.update()
    armature.matrix_world = head.matrix_world
    armature.show_in_front = True
    select_alone(bpy.context, armature)
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature_data(armature).edit_bones
    at, up = Vector(to_blender(pivot).tolist()), Vector((0.0, 0.0, unit))
    turning, still = (bones.new(name) for name in names)
    turning.head, turning.tail = at, at + up
    still.head, still.tail = at - up, at
    turning.parent = still
    bpy.ops.object.mode_set(mode="OBJECT")
    select_alone(bpy.context, head)
    return armature


def _deform(
    shares: Mapping[bpy.types.Object, NDArray[np.floating[Any]]], bones: Sequence[str], armature: bpy.types.Object
) -> None:
    """Let the armature deform meshes, each by the shares (V,) of its vertices, and carry those without a parent."""
    for obj, share in shares.items():
        for name, weights in zip(bones, (share, 1.0 - share), strict=True):
            group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)  # meshes may share their data
            for weight in np.unique(weights[weights > 0.0]):
                group.add(np.flatnonzero(weights == weight).tolist(), float(weight), "REPLACE")
        modifier: Any = obj.modifiers.new("Neck", "ARMATURE")
        modifier.object = armature
        obj.modifiers.move(len(obj.modifiers) - 1, 0)
        if obj.parent == armature.parent and obj.parent_type == "OBJECT":
            world = obj.matrix_world.copy()
            obj.parent = armature
            obj.matrix_world = world
