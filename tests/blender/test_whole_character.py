"""A rigged character with eyes, teeth and hair moves as one: no part stays behind, and none is stretched."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live import LiveHeadObject
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.characters import read_kinds
from facemime.blender.meshes import read_landmarks
from facemime.blender.rigs import read_rig
from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.rig import Part
from facemime.core.takes.neutral import calibrate
from tests.helpers.characters import make_character, shown
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

RIGID = ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "hair", "body")
CARRIED = {"hair": 1e-5, "teeth_upper": 1e-5, "eye_left": 2e-3, "eye_right": 2e-3, "teeth_lower": 0.01, "tongue": 0.01}
"""Distance in metres by which the middle of each part may leave the head bone: eyes turn, lower teeth open."""


def lengths(obj: bpy.types.Object, points: np.ndarray) -> np.ndarray:
    """Return the length of each edge."""
    edges = np.array([edge.vertices[:] for edge in obj.data.edges])
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def carried(armature: bpy.types.Object, points: np.ndarray) -> np.ndarray:
    """Return where the head bone moves points of the world."""
    bone = armature.pose.bones["Head"]
    world = armature.matrix_world
    moved = np.array(world @ bone.matrix @ bone.bone.matrix_local.inverted() @ world.inverted())
    return points @ moved[:3, :3].T + moved[:3, 3]


def assert_as_one(objects: dict[str, bpy.types.Object], rest: dict[str, np.ndarray]) -> float:
    """Check that all parts move together, and return how far the crown has moved."""
    armature = objects["head"].parent
    now = {name: shown(obj) for name, obj in objects.items()}
    for name in RIGID:
        before = lengths(objects[name], rest[name])
        np.testing.assert_allclose(lengths(objects[name], now[name]), before, atol=1e-4, err_msg=name)
    for name, slack in CARRIED.items():
        away = now[name].mean(axis=0) - carried(armature, rest[name]).mean(axis=0)
        assert np.linalg.norm(away) < slack, name
    np.testing.assert_allclose(now["body"], rest["body"], atol=1e-6)
    skin, height = objects["head"], rest["head"][:, 2]
    scalp, collar = height > 0.08, height < -0.13
    np.testing.assert_allclose(now["head"][scalp], carried(armature, rest["head"])[scalp], atol=1e-3)
    np.testing.assert_allclose(now["head"][collar], rest["head"][collar], atol=1e-3)
    face = read_landmarks(skin)
    moved = np.linalg.norm(now["head"] - carried(armature, rest["head"]), axis=1)
    assert moved[height > -0.08].max() < 2.0 * max(moved[face].max(), 1e-4), "no skin runs ahead of the landmarks"
    return float(np.linalg.norm(now["hair"] - rest["hair"], axis=1).max())


def bound(start: str) -> tuple[dict[str, bpy.types.Object], dict[str, np.ndarray]]:
    """Make a character, and bind it by one call from one of its meshes; returns it and its vertices at rest."""
    objects = make_character(rig=True, hair=True)
    rest = {name: shown(obj) for name, obj in objects.items()}
    bpy.context.view_layer.objects.active = objects[start]
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    assert bpy.context.active_object == objects["head"]
    assert set(map(Part, read_kinds(objects["hair"].data).tolist())) == {Part.ON_HEAD}
    return objects, rest


@pytest.mark.parametrize("start", first_of(["body", "hair"]))
def test_a_bake_moves_a_rigged_character_with_eyes_teeth_and_hair_as_one(start):
    objects, rest = bound(start)
    puppet_head(bpy.context.scene, objects["head"], performance())
    travelled = []
    for frame in range(1, 61, 4):
        bpy.context.scene.frame_set(frame)
        travelled.append(assert_as_one(objects, rest))
    assert max(travelled) > 0.02


def test_live_a_rigged_character_with_eyes_teeth_and_hair_moves_as_one():
    objects, rest = bound("body")
    head, take = objects["head"], performance()
    live = LiveHeadObject(head, own_targets(head))
    driver = HeadDriver(read_rig(head), calibrate(take))
    live.attach()
    travelled = []
    for number in np.flatnonzero(take.found)[::4]:
        live.write(driver.frame(take.result(int(number))))
        travelled.append(assert_as_one(objects, rest))
    live.detach(keep=False)
    assert max(travelled) > 0.02
