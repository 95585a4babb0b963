"""Bones of objects that are known to be armatures."""

from __future__ import annotations

import bpy


def rest_bones(armature: bpy.types.Object) -> bpy.types.ArmatureBones:
    """Return the bones of an armature at rest."""
    return armature_data(armature).bones


def armature_data(armature: bpy.types.Object) -> bpy.types.Armature:
    """Return the data of an armature."""
    assert isinstance(armature.data, bpy.types.Armature), f"{armature.name} is no armature"
    return armature.data


def posed_bones(armature: bpy.types.Object) -> bpy.types.bpy_prop_collection[bpy.types.PoseBone]:
    """Return the bones of an armature as they are posed."""
    assert armature.pose is not None, f"{armature.name} is no armature"
    return armature.pose.bones
