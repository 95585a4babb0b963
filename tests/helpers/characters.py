"""Characters on an armature as other artists make them, built from the parts of the built-in head, for tests.

As a script it writes one to a .blend file: `python tests/helpers/characters.py FILE`.
"""

import sys

import bpy
import numpy as np
from mathutils import Matrix

from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import PART_PROPERTY
from facemime.core.heads.rig import Part

TRUTH = {
    "eye_left": {Part.EYE_LEFT},
    "eye_right": {Part.EYE_RIGHT},
    "teeth_upper": {Part.TEETH_UPPER},
    "teeth_lower": {Part.TEETH_LOWER},
    "tongue": {Part.TEETH_LOWER},
}


def _ours(key: str) -> bool:
    return key.startswith("facemime")


def make_character(*, rig: bool, y_up: bool = False, hair: bool = False) -> dict[str, bpy.types.Object]:
    """Make a character from the built-in head: meshes without useful names, with a body, in world axes."""
    head = add_head(bpy.context)
    objects = {"head": head, **{child[PART_PROPERTY]: child for child in head.children}}
    for name in ("lashes", "hair"):
        bpy.data.objects.remove(objects.pop(name))
    if hair:
        objects["hair"] = _cap(head)
    bpy.context.view_layer.update()
    bpy.ops.mesh.primitive_cylinder_add(radius=0.12, depth=0.6, location=(0.0, 0.05, -0.45 if hair else -0.6))
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


def _cap(head: bpy.types.Object) -> bpy.types.Object:
    """Make a cap of hair 3 mm above the scalp."""
    places = shown(head)
    high = places[:, 2] > 0.06 + 0.5 * np.clip(-places[:, 1] - 0.05, 0.0, None)
    faces = [face.vertices[:] for face in head.data.polygons if high[list(face.vertices)].all()]
    used, numbers = np.unique(np.concatenate(faces), return_inverse=True)
    normals = np.array([vertex.normal for vertex in head.data.vertices])
    ends = np.cumsum([len(face) for face in faces])[:-1]
    data = bpy.data.meshes.new("Cap")
    corners = [part.tolist() for part in np.split(numbers, ends)]
    data.from_pydata((places + 0.003 * normals)[used].tolist(), [], corners)
    cap = bpy.data.objects.new("Cap", data)
    head.users_collection[0].objects.link(cap)
    return cap


def _put_on_armature(objects: dict[str, bpy.types.Object], *, y_up: bool) -> None:
    """Put all objects on an armature with a head bone, turned and scaled as in FBX files if `y_up`."""
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
    if "hair" in objects:
        _hold_neck(objects["head"], armature)


def _hold_neck(skin: bpy.types.Object, armature: bpy.types.Object) -> None:
    """Let the lower end of the neck stay with the body, as the skin of a character does."""
    spine = skin.vertex_groups.new(name="Spine")
    for vertex, (_, _, height) in zip(skin.data.vertices, shown(skin), strict=True):
        share = float(np.clip((height + 0.13) / 0.05, 0.0, 1.0))
        skin.vertex_groups["Head"].add([vertex.index], share, "REPLACE")
        spine.add([vertex.index], 1.0 - share, "REPLACE")


def shown(obj: bpy.types.Object) -> np.ndarray:
    """Return (V, 3) vertices in the world, as they are displayed."""
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    world = np.array(evaluated.matrix_world)
    flat = np.empty(3 * len(evaluated.data.vertices), dtype=np.float32)
    evaluated.data.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def turn_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation that best takes points (N, 3) to others."""
    u, _, vt = np.linalg.svd((after - after.mean(axis=0)).T @ (before - before.mean(axis=0)))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


if __name__ == "__main__":
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    make_character(rig=True, hair=True)
    bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
