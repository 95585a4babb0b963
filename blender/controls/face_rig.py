"""A rig for a head without one: Rigify's face, placed by the landmarks (method.md, section 9.8)."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...core.errors import HeadError
from ...core.face.landmarks import EYE_LEFT, EYE_RIGHT
from ...core.heads.part_names import FaceBones
from ...core.heads.rig import HeadRig
from ...core.numeric.arrays import FloatArray
from ...core.rigs.metarig import FaceShape, Joint, MetarigFit
from ..characters import write_bones
from ..frames import from_blender, to_blender
from ..heads.family import armature_of
from ..heads.neck import remove_neck
from ..meshes import armature_data, mesh_of, require_own
from ..names import NECK_PROPERTY
from ..rigs import read_rig
from ..view_layers import select_alone
from .skinning import bind_to_rig

_KEPT = ("spine", "spine.001", "spine.002", "spine.003", "spine.004", "spine.005", "spine.006", "face")
"""Bones of the human that stay beside those of the face."""
_INSIDE = ("eye", "teeth", "tongue")
"""Beginnings of the names of bones that are not on the skin."""
_DEEP = 0.1
"""Depth behind the lids, in eye distances, at which the eye of a head without eyeballs turns."""
_LENGTH = 0.2
"""Length of the bone of an eye, in eye distances."""
_BONES = FaceBones(head="head", eye_right="ORG-eye.R", eye_left="ORG-eye.L", jaw="jaw_master")


def add_face_rig(head: bpy.types.Object) -> bpy.types.Object:
    """Give a head Rigify's face, to which its meshes are bound, and return the armature.

    Raises HeadError if the head has a rig, Rigify is disabled, or cannot generate the rig; nothing is left then.
    """
    require_own(mesh_of(head))
    armature = armature_of(head)
    if armature is not None and NECK_PROPERTY not in armature:
        raise HeadError("{name} has a rig: {armature}. Use Learn Controls.", name=head.name, armature=armature.name)
    if not hasattr(bpy.types.PoseBone, "rigify_type"):
        raise HeadError("Rigify is disabled. Enable it in Preferences > Add-ons, and try again.")
    if armature is not None:
        remove_neck(armature)
    rig, before = read_rig(head), set(bpy.data.objects)
    try:
        armature = _generated(head, rig)
        bind_to_rig(head, armature, rig)
    except (RuntimeError, KeyError) as error:
        for obj in set(bpy.data.objects) - before:
            bpy.data.objects.remove(obj)
        raise HeadError("Rigify could not generate the rig: {reason}", reason=error) from error
    finally:
        select_alone(bpy.context, head)
    write_bones(head, armature, _BONES)
    return armature


def _generated(head: bpy.types.Object, rig: HeadRig) -> bpy.types.Object:
    """Place the metarig in a head, and generate its rig. Raises RuntimeError or KeyError if Rigify is different."""
    bpy.ops.object.armature_human_metarig_add()  # type: ignore[attr-defined]  # it is Rigify's
    metarig = bpy.context.active_object
    assert metarig is not None
    metarig.name = f"{head.name} Metarig"
    metarig.matrix_world = head.matrix_world
    _place(metarig, head, rig)
    data: Any = armature_data(metarig)  # whose properties are Rigify's
    data.rigify_rig_basename = f"{head.name} Rig"
    bpy.ops.pose.rigify_generate()  # type: ignore[attr-defined]  # it is Rigify's
    armature: bpy.types.Object = data.rigify_target_rig
    armature.matrix_world = head.matrix_world
    armature.show_in_front = True
    metarig.hide_set(True)
    metarig.hide_render = True
    return armature


def _place(metarig: bpy.types.Object, head: bpy.types.Object, rig: HeadRig) -> None:
    """Keep the bones of face and spine, and place their joints."""
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature_data(metarig).edit_bones
    for bone in list(bones):
        if bone.name not in _KEPT and not _is_of_face(bone):
            bones.remove(bone)
    joints: dict[Joint, FloatArray] = {
        (bone.name, end): from_blender(np.array(getattr(bone, end))) for bone in bones for end in ("head", "tail")
    }
    placed = _placed(joints, {bone.name for bone in bones if _is_of_face(bone)}, rig, head)
    connected = {bone.name: bone.use_connect for bone in bones}
    for bone in bones:
        bone.use_connect = False
    for bone in bones:
        bone.head, bone.tail = (Vector(to_blender(placed[bone.name, end]).tolist()) for end in ("head", "tail"))
    for side in "LR":
        eye = bones[f"eye.{side}"]
        eye.tail = eye.head + Vector((0.0, -_LENGTH * rig.eye_distance, 0.0))
    for bone in bones:
        bone.use_connect = connected[bone.name]
    bpy.ops.object.mode_set(mode="OBJECT")


def _is_of_face(bone: bpy.types.EditBone | bpy.types.Bone) -> bool:
    return bone.name != "face" and any(above.name == "face" for above in bone.parent_recursive)


def _placed(
    joints: dict[Joint, FloatArray], of_face: set[str], rig: HeadRig, head: bpy.types.Object
) -> dict[Joint, FloatArray]:
    """Carry joints over to a head; those of the face onto its skin, unless landmarks place them."""
    fit = MetarigFit(joints, shape_of(rig))
    places = [tuple(place) for place in np.asarray(rig.vertices, dtype=np.float64).tolist()]
    skin: Any = BVHTree.FromPolygons(
        places, [[corner for corner in face if corner >= 0] for face in _faces_of_skin(rig)]
    )
    fixed = {tuple(np.round(joints[joint], 5)) for joint in fit.placed}
    placed = {}
    for joint, place in joints.items():
        bone, _end = joint
        if bone not in of_face:
            placed[joint] = fit.body(place[None])[0]
            continue
        placed[joint] = fit.face(place[None])[0]
        if not bone.startswith(_INSIDE) and tuple(np.round(place, 5)) not in fixed:
            near = skin.find_nearest(Vector(placed[joint].tolist()))[0]
            placed[joint] = placed[joint] if near is None else np.array(near)
    return placed


def _faces_of_skin(rig: HeadRig) -> list[list[int]]:
    """Return the faces of the head's own mesh that are skin."""
    faces = np.asarray(rig.faces, dtype=np.intp)
    kinds = rig.kinds[: len(rig.vertices)]
    return list(faces[(kinds[faces[:, 0]] == 0)].tolist())


def shape_of(rig: HeadRig) -> FaceShape:
    """Return what places the joints in a head."""
    points = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    eyes = []
    for corners in (EYE_RIGHT, EYE_LEFT):
        middle = points[corners].mean(axis=0) + (0.0, 0.0, _DEEP * rig.eye_distance)
        balls = np.asarray(rig.eyeballs, dtype=np.float64)[:, :3]
        away = np.linalg.norm(balls - middle, axis=1)
        found = len(away) and away.min() < 0.5 * rig.eye_distance
        eyes.append(balls[away.argmin()] if found else middle)
    return FaceShape(points, np.asarray(rig.jaw_pivot, dtype=np.float64), np.array(eyes))
