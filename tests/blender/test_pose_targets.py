"""Targets of the pose of head and eyes: the head itself, bones, other objects."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import PoseTarget, own_targets
from facemime.blender.characters import rest_matrix, write_bones
from facemime.blender.frames import to_blender
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks, read_vertices
from facemime.blender.names import PART_PROPERTY, PIVOT_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.face.landmarks import EYE_CORNERS, outer_eye_distance
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.part_names import FaceBones
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.operators.puppet import running
from tests.helpers.characters import make_character
from tests.helpers.live_ticks import outcome_of_ticks, ticks_until
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def test_the_pose_of_the_head_goes_to_a_bone_and_that_of_the_eyes_to_objects(looping):
    head = add_head(bpy.context)
    bpy.ops.object.armature_add()
    armature = bpy.context.active_object
    bpy.ops.object.empty_add()
    empty = bpy.context.active_object
    posing = bpy.context.scene.facemime.posing
    posing.object, posing.bone, posing.eye_left = armature, "Bone", empty
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    bone = armature.pose.bones["Bone"]
    ticks_until(lambda: bone.rotation_quaternion.angle > 0.05)
    frame = running().shown.heads
    assert frame and tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)
    bpy.ops.facemime.stop_puppet()
    assert bone.rotation_quaternion.angle < 1e-6
    posing.bone = "Nose"
    with pytest.raises(RuntimeError, match="no bone Nose"):
        bpy.ops.facemime.puppet()
    assert running() is None


def test_deleting_the_pose_object_stops_the_puppet_with_the_head_at_rest(take):
    head = add_head(bpy.context)
    empty = bpy.data.objects.new("Pose", None)
    bpy.context.collection.objects.link(empty)
    scene = bpy.context.scene
    scene.facemime.posing.object, scene.facemime.source.loop = empty, True
    teeth = next(child for child in head.children if child[PART_PROPERTY] == "teeth_lower")
    bpy.ops.facemime.puppet()
    ticks_until(lambda: abs(teeth.delta_rotation_euler.x) > 0.02)
    bpy.data.objects.remove(empty)
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None
    assert head.data.shape_keys is None and tuple(teeth.delta_rotation_euler) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("mode", ["XYZ", "QUATERNION", "AXIS_ANGLE"])
def test_a_pose_rotates_the_head_about_its_own_axes_in_any_orientation(mode):
    bpy.ops.object.empty_add(rotation=(0.3, 0.2, 1.1))
    parent = bpy.context.active_object
    head = add_head(bpy.context)
    head.parent, head.rotation_mode = parent, mode
    if mode == "QUATERNION":
        head.rotation_quaternion = (0.9, 0.1, -0.3, 0.2)
    else:
        head.rotation_euler = (0.4, -0.2, 0.7)
    bpy.context.view_layer.update()
    before = np.array(head.matrix_world.to_3x3().normalized())
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    target = PoseTarget(head)
    target.apply(turn, np.array([0.1, 0.2, 0.3]))
    bpy.context.view_layer.update()
    in_blender = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(np.array(head.matrix_world.to_3x3().normalized()), before @ in_blender, atol=1e-5)
    target.rest()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(head.matrix_world.to_3x3().normalized()), before, atol=1e-6)


@pytest.mark.parametrize("scale", [(-1, 1, 1), (1, -2, 1), (-1, -1, -1)])
def test_a_mirrored_head_moves_like_its_mirror_image(scale):
    head = add_head(bpy.context)
    head.rotation_euler, head.scale = (0.4, -0.2, 0.7), scale
    bpy.context.view_layer.update()
    before = np.array(head.matrix_world)
    turn, move = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]), np.array([0.1, 0.2, 0.3])
    PoseTarget(head).apply(turn, None)
    bpy.context.view_layer.update()
    chin = np.array([0.0, -0.1, -0.1])
    in_blender = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    if len(set(np.abs(scale))) == 1:  # otherwise a rotated head is skewed in any case
        turned = np.array(head.matrix_world)[:3, :3] @ chin
        np.testing.assert_allclose(turned, before[:3, :3] @ in_blender @ chin, atol=1e-5)
    PoseTarget(head).apply(np.eye(3), move)
    bpy.context.view_layer.update()
    moved = np.array(head.matrix_world)[:3, 3] - before[:3, 3]
    np.testing.assert_allclose(moved, before[:3, :3] @ (0.1, 0.3, -0.2), atol=1e-5)


def test_the_bone_of_a_flat_eye_turns_by_a_share_that_keeps_the_iris_between_the_lids():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    armature = head.parent
    places = read_vertices(head.data)[read_landmarks(head)]
    unit = outer_eye_distance(places)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for name, corners, behind in (("Eye.L", EYE_CORNERS[2:], 0.13), ("Eye.R", EYE_CORNERS[:2], 0.5)):
        bone = armature.data.edit_bones.new(name)
        to_armature = armature.matrix_world.inverted() @ rest_matrix(head)
        bone.head = to_armature @ Vector(to_blender(places[corners].mean(axis=0) + [0.0, 0.0, behind * unit]))
        bone.tail = bone.head + Vector((0.0, -0.02, 0.0))
    bpy.ops.object.mode_set(mode="OBJECT")
    write_bones(head, armature, FaceBones("Head", "Eye.R", "Eye.L"))
    targets = own_targets(head)
    assert targets["eye_left"].strength == 1.0 and 0.3 < targets["eye_right"].strength < 0.5
    looking = euler_to_matrix(0.0, 0.3, 0.0)
    for eye in ("eye_left", "eye_right"):
        targets[eye].apply(looking, None)
        turned = armature.pose.bones[targets[eye].bone].matrix_basis.to_quaternion().angle
        assert abs(turned - 0.3 * targets[eye].strength) < 1e-4
    assert targets["eye_right"].turned(np.stack([looking] * 3)).shape == (3, 3, 3)


@pytest.mark.parametrize("below", [0.0, 1.6, 20.0])
def test_fewer_keyframes_err_as_little_however_far_the_origin_of_an_object_is_from_its_head(below):
    head, scene, take = add_head(bpy.context), bpy.context.scene, performance()
    for child in list(head.children):
        bpy.data.objects.remove(child)
    place = np.array(head.get(PIVOT_PROPERTY, (0.0, 0.0, 0.0))) + (0.0, 0.0, below)
    head.data.transform(Matrix.Translation((0.0, 0.0, below)))
    head[PIVOT_PROPERTY] = place.tolist()
    pose = take.pose.copy()
    pose[:, 1:4] += np.random.default_rng(0).normal(scale=0.01, size=(len(pose), 3)).astype(pose.dtype)
    paths = []
    for clean in (0.0, 0.01):
        settings = PuppetSettings(bake=BakeSettings(clean=clean), smoothing=0.0, neutral=0.0)
        puppet_head(scene, head, replace(take, pose=pose), settings)
        paths.append([])
        for frame in range(2, 60):
            scene.frame_set(frame)
            paths[-1].append(head.matrix_world @ Vector(place + (0.0, -0.09, 0.05)))
    error = np.linalg.norm(np.subtract(*paths), axis=1).max() / read_rig(head).eye_distance
    assert 0.001 < error < 0.025
