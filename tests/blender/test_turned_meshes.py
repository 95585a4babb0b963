"""Meshes that lie on their side or face elsewhere are turned upright when they are bound, and look the same."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from facemime.blender.heads import binding
from facemime.blender.heads.binding import bind_head, read_marks
from facemime.blender.meshes import read_vertices
from facemime.blender.names import LANDMARKS_PROPERTY
from facemime.cli.character_files import bound_character
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import from_ibug
from facemime.core.heads.bind import MARKS
from tests.helpers.bare_heads import bare_head, in_scene, off, pick
from tests.helpers.characters import make_character, shown
from tests.helpers.thorough import first_of

SAME = "the vertices now face -Y, and the object is rotated instead; it looks the same"
LYING = {
    "on its back": (-np.pi / 2.0, 0.0, 0.0),
    "askew": (1.2, 0.4, 2.0),
    "on its face": (np.pi / 2.0, 0.0, 0.0),
    "tilted": (0.7, 0.0, 0.0),
}


def test_marked_points_bind_a_mesh_on_its_side_without_moving_it_in_the_scene(true):
    obj = bare_head()
    obj.data.transform(Matrix.Rotation(1.2, 4, "X") @ Matrix.Rotation(0.7, 4, "Z"))
    before = in_scene(obj)
    for number in MARKS:
        pick(obj, int(true[from_ibug([number])[0]]))
        assert bpy.ops.facemime.mark_point(point=str(number)) == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(read_marks(obj.data)) == len(MARKS)
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert off(obj, true).mean() < 0.03
    assert np.linalg.norm(in_scene(obj) - before, axis=1).max() < 1e-5
    vertices = read_vertices(obj.data)
    nose, chin = vertices[true[from_ibug([30, 8])]]
    assert nose[2] == vertices[true].min(axis=0)[2] and chin[1] > nose[1]


def test_an_imported_mesh_is_bound_without_marks_and_its_vertices_are_rotated_upright(true):
    obj = bare_head()
    lying = Matrix.Rotation(np.pi / 2.0, 4, "X")
    obj.data.transform(lying.inverted())
    obj.matrix_world = Matrix.Translation((3.0, 1.0, 2.0)) @ lying @ Matrix.Scale(20.0, 4)
    bpy.context.view_layer.update()
    before = in_scene(obj)
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert off(obj, true).mean() < 0.02
    assert np.linalg.norm(in_scene(obj) - before, axis=1).max() < 1e-4
    nose, chin = read_vertices(obj.data)[true[from_ibug([30, 8])]]
    assert nose[2] == read_vertices(obj.data)[true].min(axis=0)[2] and chin[1] > nose[1]
    assert np.abs(np.array(obj.matrix_world.to_euler())).max() < 1e-5


def test_a_mesh_that_faces_backwards_is_bound_without_marks_and_stays_in_place(true):
    obj = bare_head()
    obj.data.transform(Matrix.Rotation(np.pi, 4, "Z"))
    before = in_scene(obj)
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert off(obj, true).mean() < 0.02
    assert np.linalg.norm(in_scene(obj) - before, axis=1).max() < 1e-5
    assert abs(abs(obj.matrix_world.to_euler().z) - np.pi) < 0.05


@pytest.mark.parametrize(
    ("rotation", "scale"),
    first_of([((0.4, -0.3, 0.9), (3, 3, 3)), ((0.0, 0.0, 2.2), (1, 1, 1)), ((0.0, 0.0, 0.0), (-1, 1, 1))], rows=True),
)
def test_a_rotated_or_mirrored_object_is_bound_without_marks(true, rotation, scale):
    obj = bare_head()
    obj.rotation_euler, obj.scale = rotation, scale
    bpy.context.view_layer.update()
    rest, before = read_vertices(obj.data), obj.matrix_world.copy()
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert off(obj, true).mean() < 0.02
    np.testing.assert_array_equal(read_vertices(obj.data), rest)
    np.testing.assert_allclose(np.array(obj.matrix_world), np.array(before), atol=1e-6)


def placed(obj: bpy.types.Object) -> list[float]:
    """All numbers that place an object: its matrices, and the channels of its rotation."""
    matrices = (obj.matrix_world, obj.matrix_basis, obj.matrix_parent_inverse)
    channels = (obj.rotation_euler, obj.rotation_quaternion, obj.delta_rotation_euler, obj.location, obj.scale)
    return [*(value for matrix in matrices for row in matrix for value in row), *(v for c in channels for v in c)]


@pytest.mark.parametrize("pose", first_of([(0.3, 0.5, 0.1), None]))
@pytest.mark.parametrize("rotation", first_of(LYING.values(), quick=2), ids=LYING)
def test_a_skinned_mesh_on_a_rotated_armature_is_bound_without_turning_it(capfd, rotation, pose):
    objects = make_character(rig=True)
    armature = objects["head"].parent
    armature.rotation_euler = rotation
    if pose is not None:
        bone = armature.pose.bones["Head"]
        bone.rotation_mode, bone.rotation_euler = "XYZ", pose
    before = {name: shown(obj) for name, obj in objects.items()}
    rest, places = read_vertices(objects["head"].data), {obj: placed(obj) for obj in (armature, *objects.values())}
    bpy.context.view_layer.objects.active = objects["head"]
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    for name, obj in objects.items():
        np.testing.assert_allclose(shown(obj), before[name], atol=1e-6)
    assert {obj: placed(obj) for obj in places} == places and SAME not in capfd.readouterr().out
    np.testing.assert_array_equal(read_vertices(objects["head"].data), rest)


@pytest.mark.parametrize("angle", first_of([0.4, 0.0]))
def test_the_turn_of_a_skinned_mesh_is_reported_and_its_armature_is_kept(capfd, angle):
    objects = make_character(rig=True, y_up=True)
    armature = objects["head"].parent
    armature.rotation_euler.rotate(Matrix.Rotation(angle, 3, (0.4, 0.5, 0.6)))
    before, place = {name: shown(obj) for name, obj in objects.items()}, placed(armature)
    bpy.context.view_layer.objects.active = objects["head"]
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    assert placed(armature) == place and f"{objects['head'].name}: {SAME}" in capfd.readouterr().out
    for name, obj in objects.items():
        np.testing.assert_allclose(shown(obj), before[name], atol=1e-5)


def test_the_command_says_that_a_mesh_was_rotated(capfd):
    objects = make_character(rig=True, y_up=True)
    head, _ = bound_character(objects["head"])
    assert f"{head.name}: {SAME}." in capfd.readouterr().err
    bound_character(head)
    assert SAME not in capfd.readouterr().err


def y_up_mesh() -> bpy.types.Object:
    """A bare head whose object is rotated upright."""
    obj = bare_head()
    obj.data.transform(Matrix.Rotation(-np.pi / 2.0, 4, "X"))
    obj.rotation_euler.x = np.pi / 2.0
    return obj


def keyed(obj: bpy.types.Object) -> None:
    obj.keyframe_insert("rotation_euler", frame=1)


def driven(obj: bpy.types.Object) -> None:
    obj.driver_add("rotation_euler", 0).driver.expression = "pi / 2"


def constrained(obj: bpy.types.Object) -> None:
    target = bpy.data.objects.new("Target", None)
    bpy.context.scene.collection.objects.link(target)
    target.rotation_euler, obj.rotation_euler = obj.rotation_euler, (0.0, 0.0, 0.0)
    obj.constraints.new("COPY_ROTATION").target = target


@pytest.mark.parametrize("hold", first_of([keyed, driven, constrained]))
def test_a_mesh_whose_rotation_is_held_is_not_turned_but_reported(hold):
    obj = y_up_mesh()
    hold(obj)
    before, rest = shown(obj), read_vertices(obj.data)
    with pytest.raises(RuntimeError, match="rotation is animated or constrained"):
        bpy.ops.facemime.bind_landmarks()
    bpy.context.scene.frame_set(5)
    np.testing.assert_allclose(shown(obj), before, atol=1e-6)
    np.testing.assert_array_equal(read_vertices(obj.data), rest)
    assert LANDMARKS_PROPERTY not in obj.data


def test_a_mesh_that_was_turned_is_turned_back_if_its_face_is_then_refused(monkeypatch):
    objects = make_character(rig=True, y_up=True)
    head = objects["head"]
    before, rest, places = shown(head), read_vertices(head.data), [placed(obj) for obj in objects.values()]

    def refused(*_: object) -> None:
        raise HeadError("No face was found on the mesh.")

    monkeypatch.setattr(binding, "sort_character", refused)
    with pytest.raises(HeadError, match="No face"):
        bind_head(head)
    np.testing.assert_allclose(shown(head), before, atol=1e-6)
    np.testing.assert_allclose(read_vertices(head.data), rest, atol=1e-5 * np.abs(rest).max())
    np.testing.assert_allclose([placed(obj) for obj in objects.values()], places, atol=1e-5)
