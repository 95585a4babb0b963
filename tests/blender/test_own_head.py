"""Preparing any mesh as a head."""

import bpy
import numpy as np
import pytest

from facemime.blender.heads import binding
from facemime.blender.heads.binding import bind_character, bind_head, check_object, read_marks
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks, read_regions, read_selection, read_vertices
from facemime.blender.names import LANDMARKS_PROPERTY, REGION_GROUPS, SELECTION_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.core.control_points.select import select_control_points
from facemime.core.control_points.selection import to_json
from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT, LIPS, from_ibug
from facemime.core.takes.file import load_take, save_take
from lab.training.data import DATA
from tests.helpers.bare_heads import bare_head, off, pick
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

CHARACTERS = DATA / "characters"


def test_an_upright_mesh_is_bound_without_marks_and_can_be_driven(true, tmp_path):
    obj = bare_head()
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    assert off(obj, true).mean() < 0.02
    assert read_regions(obj).any(axis=1).all()
    assert check_object(obj) == []
    save_take(performance(), tmp_path / "take.facetake")
    assert bpy.ops.facemime.puppet_video(filepath=str(tmp_path / "take.facetake")) == {"FINISHED"}


def test_a_landmark_is_moved_to_the_selected_vertex(true):
    obj = add_head(bpy.context)
    free = next(v for v in range(len(obj.data.vertices)) if v not in true)
    pick(obj, free)
    assert bpy.ops.facemime.set_landmark(number=30) == {"FINISHED"}
    assert read_landmarks(obj)[30] == free
    pick(obj, int(true[0]))
    with pytest.raises(RuntimeError, match="Another landmark is bound to this vertex"):
        bpy.ops.facemime.set_landmark(number=30)


def test_marking_requires_a_single_selected_vertex():
    obj = add_head(bpy.context)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    with pytest.raises(RuntimeError, match="1781 vertices are selected"):
        bpy.ops.facemime.mark_point(point="30")
    assert not read_marks(obj.data)


def test_the_binding_survives_renaming_copying_saving_and_loading(true, tmp_path):
    obj = add_head(bpy.context)
    regions = read_regions(obj)
    obj.name, obj.data.name = "Aunt", "Aunts Mesh"
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    assert copy.data != obj.data
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "heads.blend"))
    names = obj.name, copy.name
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "heads.blend"))
    for name in names:
        loaded = bpy.data.objects[name]
        np.testing.assert_array_equal(read_landmarks(loaded), true)
        np.testing.assert_allclose(read_regions(loaded), regions, atol=1e-6)


def test_a_binding_can_be_undone_and_redone(true):
    obj = bare_head()
    name = obj.name
    bpy.ops.ed.undo_push(message="bare")
    bind_head(obj)
    bpy.ops.ed.undo_push(message="bound")
    bpy.ops.ed.undo()
    assert LANDMARKS_PROPERTY not in bpy.data.objects[name].data
    bpy.ops.ed.redo()
    assert len(read_landmarks(bpy.data.objects[name])) == 66


def test_a_changed_vertex_count_is_reported_with_both_numbers():
    obj = add_head(bpy.context)
    obj.data.vertices.add(5)
    with pytest.raises(RuntimeError, match="has changed from 1781 to 1786 since"):
        bpy.ops.facemime.check_head()


def test_lost_regions_can_be_proposed_again():
    obj = add_head(bpy.context)
    for name in REGION_GROUPS:
        obj.vertex_groups.remove(obj.vertex_groups[name])
    assert bpy.ops.facemime.propose_regions() == {"FINISHED"}
    assert read_regions(obj).any(axis=1).all()


def test_a_landmark_outside_all_regions_is_reported():
    obj = add_head(bpy.context)
    nose = int(read_landmarks(obj)[30])
    for name in REGION_GROUPS:
        obj.vertex_groups[name].remove([nose])
    problems = [finding.problem for finding in check_object(obj)]
    assert problems == ["Landmarks 30 lie in no region."]


@pytest.mark.thorough
@pytest.mark.skipif(not CHARACTERS.is_dir(), reason="the characters of ../shared/data are not here")
@pytest.mark.parametrize("name", ["rigged", "scan", "vroid"])
def test_no_character_has_misplaced_lids(name):
    bpy.ops.import_scene.gltf(filepath=str(CHARACTERS / f"{name}.glb"))
    head, _ = bind_character(next(obj for obj in bpy.data.objects if obj.type == "MESH" and obj.name[:3] != "Ico"))
    assert not [finding for finding in check_object(head) if "brow" in finding.problem]


def test_the_operator_selects_the_points_that_the_function_selects(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    obj = add_head(bpy.context)
    outcome = bpy.ops.facemime.select_control_points(
        filepath=str(tmp_path / "take.facetake"), tolerance=0.5, max_points=20, add="33", remove="0-2"
    )
    assert outcome == {"FINISHED"}
    chosen = read_selection(obj.data)
    del obj.data[SELECTION_PROPERTY]
    never = [0, 1, 2]
    take = load_take(tmp_path / "take.facetake")
    expected = select_control_points(read_rig(obj), take, tolerance=0.005, max_points=20, always=[33], never=never)
    np.testing.assert_array_equal(chosen.membership, expected.membership)
    assert [(s.action, s.landmark) for s in chosen.steps] == [(s.action, s.landmark) for s in expected.steps]
    assert len(chosen.landmarks) <= 20 and 33 in chosen.landmarks and not set(never) & set(chosen.landmarks)


def test_selected_points_drive_the_head_until_all_landmarks_are_restored(tmp_path):
    obj = add_head(bpy.context)
    obj.data[SELECTION_PROPERTY] = to_json(select_control_points(read_rig(obj), performance(), max_points=15))
    assert read_rig(obj).control_points.any(axis=0).sum() <= 15
    assert bpy.ops.facemime.use_all_landmarks() == {"FINISHED"}
    assert read_rig(obj).control_points is None


def test_a_cube_is_not_a_face():
    bpy.ops.mesh.primitive_cube_add()
    with pytest.raises(RuntimeError, match="too coarse for 66 landmarks"):
        bpy.ops.facemime.bind_landmarks()


def tube(rings: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces, numbered from `first`, of an open tube through rings (N, K, 3)."""
    number = first + np.arange(rings.shape[0] * rings.shape[1]).reshape(rings.shape[:2])
    around = np.roll(number, -1, axis=1)
    quads = np.stack([number[:-1], around[:-1], around[1:], number[1:]], axis=-1)
    return rings.reshape(-1, 3), quads.reshape(-1, 4)


def add_shirt() -> bpy.types.Object:
    """A shirt with folds: an open torso from the hem to the collar, and two sleeves; 4,000 vertices."""
    height, angle = np.linspace(0.9, 1.5, 40)[:, None], np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    cuts = [0.9, 1.1, 1.35, 1.45, 1.5]
    wide, deep = (np.interp(height, cuts, s) for s in ((0.19, 0.17, 0.21, 0.12, 0.07), (0.13, 0.11, 0.13, 0.09, 0.07)))
    fold = 1.0 + 0.03 * np.sin(7.0 * angle + 6.0 * height) * np.cos(33.0 * height)
    torso = np.stack([wide * np.cos(angle) * fold, deep * np.sin(angle) * fold, height + 0.0 * angle], axis=-1)
    along, angle = np.linspace(0.17, 0.55, 30)[:, None], np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radius = np.interp(along, [0.17, 0.55], [0.09, 0.055])
    sleeve = np.stack([along + 0.0 * angle, radius * np.sin(angle), 1.36 + radius * np.cos(angle)], axis=-1)
    vertices, faces = np.empty((0, 3)), np.empty((0, 4), dtype=int)
    for rings in (torso, sleeve, sleeve * [-1.0, 1.0, 1.0]):
        more, quads = tube(rings, len(vertices))
        vertices, faces = np.concatenate([vertices, more]), np.concatenate([faces, quads])
    mesh = bpy.data.meshes.new("Shirt")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    obj = bpy.data.objects.new("Shirt", mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    return obj


@pytest.mark.parametrize("rotation", first_of([(0.0, 0.0, 0.0), (0.3, 0.2, 0.5)]))
def test_a_shirt_is_not_a_face(rotation):
    obj = add_shirt()
    obj.rotation_euler = rotation
    rest = read_vertices(obj.data)
    with pytest.raises(RuntimeError, match="No face was found on the mesh"):
        bpy.ops.facemime.bind_landmarks()
    np.testing.assert_array_equal(read_vertices(obj.data), rest)
    assert not dict(obj.data) and not dict(obj) and not obj.vertex_groups
    assert tuple(obj.rotation_euler) == pytest.approx(rotation)


def test_a_mesh_that_cannot_be_read_in_edit_mode_is_reported():
    add_head(bpy.context)
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave Edit Mode first"):
        bpy.ops.facemime.check_head()


@pytest.mark.parametrize("levels", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_subdivided_suzanne_gets_eyes_and_mouth_where_their_corners_are_marked(levels):
    bpy.ops.mesh.primitive_monkey_add()
    suzanne = bpy.context.object
    suzanne.modifiers.new("Subdivision", "SUBSURF").levels = levels
    bpy.ops.object.modifier_apply(modifier="Subdivision")
    marks = {36: 270, 39: 282, 42: 281, 45: 269, 30: 198, 48: 222, 54: 221, 8: 90}
    binding.write_marks(suzanne.data, marks)
    bind_head(suzanne)
    points = read_vertices(suzanne.data)[read_landmarks(suzanne)]
    for number, vertex in marks.items():
        assert read_landmarks(suzanne)[from_ibug([number])[0]] == vertex
    for organ, corners in ((EYE_RIGHT, (36, 39)), (EYE_LEFT, (42, 45)), (LIPS, (48, 54))):
        ends = points[from_ibug(corners)]
        away = np.linalg.norm(points[organ] - ends.mean(axis=0), axis=1)
        assert away.max() < 0.75 * np.linalg.norm(np.subtract(*ends))
