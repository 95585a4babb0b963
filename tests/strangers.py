"""A character as strangers have them, made of the built-in head."""

import bpy
import numpy as np
from mathutils import Matrix

from facemime.blender.heads.built_in import add_head
from facemime.blender.names import PART_PROPERTY


def _ours(key: str) -> bool:
    return key.startswith("facemime")


def strangers(*, rig: bool, y_up: bool = False) -> dict[str, bpy.types.Object]:
    """Make a stranger's character of the built-in head: meshes without useful names, with a body, in world axes."""
    head = add_head(bpy.context)
    objects = {"head": head, **{child[PART_PROPERTY]: child for child in head.children}}
    bpy.context.view_layer.update()
    bpy.ops.mesh.primitive_cylinder_add(radius=0.12, depth=0.6, location=(0.0, 0.05, -0.6))
    objects["body"] = bpy.context.active_object
    for number, obj in enumerate(objects.values()):
        world = obj.matrix_world.copy()
        obj.parent, obj.matrix_world = None, Matrix.Identity(4)
        obj.data.transform(world)
        obj.name = f"Object_{number}"
        obj.data.materials.clear()
        obj.shape_key_clear()
        obj.vertex_groups.clear()
        for key in filter(_ours, list(dict(obj))):
            del obj[key]
    for key in filter(_ours, list(dict(head.data))):
        del head.data[key]
    if rig:
        _put_on_armature(objects, y_up=y_up)
    bpy.context.view_layer.update()
    return objects


def _put_on_armature(objects: dict[str, bpy.types.Object], *, y_up: bool) -> None:
    """Put all on an armature with a head bone, turned and scaled as FBX files come, if `y_up`."""
    bpy.ops.object.armature_add()
    armature = bpy.context.active_object
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    bones.remove(bones[0])
    for name, low, high in (("Spine", (0, 0.05, -0.9), (0, 0.05, -0.2)), ("Head", (0, 0.03, -0.2), (0, 0.01, 0.1))):
        bone = bones.new(name)
        bone.head, bone.tail, bone.roll = low, high, 0.7
    bones["Head"].parent = bones["Spine"]
    bpy.ops.object.mode_set(mode="OBJECT")
    if y_up:
        up = Matrix.Rotation(np.pi / 2.0, 4, "X") @ Matrix.Scale(0.01, 4)
        for block in [obj.data for obj in (armature, *objects.values())]:
            block.transform(up.inverted())
        armature.matrix_world = up
    for obj in objects.values():
        obj.parent = armature
        obj.modifiers.new("Armature", "ARMATURE").object = armature
        bone = "Spine" if obj == objects["body"] else "Head"
        obj.vertex_groups.new(name=bone).add(range(len(obj.data.vertices)), 1.0, "REPLACE")
