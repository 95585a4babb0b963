"""Opening the joined lips of a scan."""

import bmesh
import bpy
import numpy as np
import pytest
from mathutils.bvhtree import BVHTree

from facemime.blender.frames import to_blender
from facemime.blender.heads.binding import check_object, propose_head_regions
from facemime.blender.heads.materials import mouth_material
from facemime.blender.heads.new_heads import add_head
from facemime.blender.heads.openings import open_lips
from facemime.blender.meshes import read_faces, read_landmarks, read_regions, read_vertices, write_landmarks
from facemime.blender.names import HEAD_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.cli.character import bind
from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, from_ibug
from facemime.core.mesh.surface import SurfaceGraph
from facemime.core.puppet.job import HeadFile
from facemime.core.takes.neutral import calibrate
from facemime.core.tracking.result import TrackResult
from tests.helpers.scans import UNIT
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


def test_joined_lips_of_a_scan_are_reported_until_they_are_opened(scan):
    words = "The lips are joined, so the mouth cannot open."
    assert words in [finding.problem for finding in check_object(scan)]
    assert bpy.ops.facemime.check_head() == {"FINISHED"}
    assert "open_lips" in [line.step for line in bpy.context.window_manager.facemime.findings]
    before = len(scan.data.vertices)
    assert bpy.ops.facemime.open_lips() == {"FINISHED"}
    assert len(scan.data.vertices) > before
    assert words not in [finding.problem for finding in check_object(scan)]
    assert "open_lips" not in [line.step for line in bpy.context.window_manager.facemime.findings]
    with pytest.raises(RuntimeError, match="already separate"):
        bpy.ops.facemime.open_lips()


@pytest.mark.parametrize("teeth", first_of([False, True]))
def test_lips_that_were_opened_are_not_cut_again(scan, teeth):
    if teeth:  # as part of the same mesh
        bpy.ops.mesh.primitive_uv_sphere_add(segments=32, radius=0.2 * UNIT, location=(0.0, 2.0 * UNIT, 0.0))
        added = bpy.context.active_object
        added.name = "Teeth"
        scan.select_set(True)
        bpy.context.view_layer.objects.active = scan
        bpy.ops.object.join()
        assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    assert bpy.ops.facemime.open_lips() == {"FINISHED"}
    vertices, faces, landmarks = read_vertices(scan.data), read_faces(scan.data), read_landmarks(scan)
    regions, materials = read_regions(scan), scan.data.materials.keys()
    with pytest.raises(RuntimeError, match="already separate"):
        bpy.ops.facemime.open_lips()
    assert len(scan.data.vertices) == len(vertices) and scan.data.materials.keys() == materials
    for before, after in (
        (vertices, read_vertices(scan.data)),
        (faces, read_faces(scan.data)),
        (landmarks, read_landmarks(scan)),
        (regions, read_regions(scan)),
    ):
        np.testing.assert_array_equal(after, before)


@pytest.mark.thorough
def test_the_bind_command_opens_lips_and_eyes_on_request(scan, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scan.blend"))
    character = HeadFile(tmp_path / "scan.blend", "Scan")
    joined = " ".join(bind(character, keys=None).problems)
    assert "lips are joined" in joined and "eyes are joined" in joined
    opened = bind(character, keys=None, cut_open=True)
    assert opened.problems == [] and opened.head.name == "Scan"


@pytest.mark.thorough
def test_seams_of_the_texture_are_closed_before_the_lips_are_opened(scan):
    across = scan.data.vertices[read_landmarks(scan)[33]].co.x
    work = bmesh.new()
    work.from_mesh(scan.data)
    seam = [edge for edge in work.edges if all(abs(v.co.x - across) < 1e-6 for v in edge.verts)]
    assert len(seam) > 20
    before = len(work.verts)
    bmesh.ops.split_edges(work, edges=seam)
    work.to_mesh(scan.data)
    work.free()
    assert len(scan.data.vertices) > before + 20
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    words = "The lips are joined, so the mouth cannot open."
    assert words in [finding.problem for finding in check_object(scan)]
    assert bpy.ops.facemime.open_lips() == {"FINISHED"}
    assert words not in [finding.problem for finding in check_object(scan)]


def test_inner_lips_are_bound_to_two_coincident_rims_in_different_regions(scan):
    bpy.ops.facemime.open_lips()
    landmarks, places, regions = read_landmarks(scan), read_vertices(scan.data), read_regions(scan)
    assert len(set(landmarks.tolist())) == 66
    upper, lower = landmarks[MOUTH_INNER_UPPER], landmarks[MOUTH_INNER_LOWER[::-1]]
    np.testing.assert_array_equal(places[upper], places[lower])
    assert (regions[1, upper] > 0.9).all() and (regions[2, lower] > 0.9).all()
    x = places[landmarks[from_ibug((48, 61, 62, 63, 54))], 0]
    assert (np.diff(x) > 0).all()


def test_opening_the_mouth_separates_the_rims(scan):
    bpy.ops.facemime.open_lips()
    rig, take = read_rig(scan), performance()
    driver = HeadDriver(rig, calibrate(take))
    gaps = []
    for frame in np.flatnonzero(take.found):
        result: TrackResult = take.result(int(frame))
        moved = driver.frame(result).vertices
        gaps.append(moved[rig.landmarks[from_ibug([66])[0]], 1] - moved[rig.landmarks[from_ibug([62])[0]], 1])
    assert max(gaps) > 0.05 * np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[from_ibug((36, 45))]]))


def test_a_dark_pocket_closes_the_mesh_behind_the_cut(scan):
    border = np.count_nonzero(SurfaceGraph(read_vertices(scan.data), read_faces(scan.data)).faces_at == 1)
    bpy.ops.facemime.open_lips()
    faces = [face for face in scan.data.polygons if face.material_index == 1]
    assert len(faces) > 12 and scan.data.materials[1].name.startswith("Facemime Mouth")
    after = SurfaceGraph(read_vertices(scan.data), read_faces(scan.data))
    assert np.count_nonzero(after.faces_at == 1) == border
    lips = read_vertices(scan.data)[read_landmarks(scan)[MOUTH_INNER_UPPER], 2]
    depth = read_vertices(scan.data)[np.unique([v for face in faces for v in face.vertices]), 2]
    assert depth.max() > lips.max() + 0.2 * UNIT


def test_shape_keys_and_vertex_groups_survive_the_cut(scan):
    scan.shape_key_add(name="Basis")
    key = scan.shape_key_add(name="Mine")
    key.data[5].co.x += 1.0
    scan.vertex_groups.new(name="Hair").add([7], 0.5, "REPLACE")
    at = [tuple(scan.data.vertices[i].co) for i in (5, 7)]
    bpy.ops.facemime.open_lips()
    count = len(scan.data.vertices)
    keys = scan.data.shape_keys.key_blocks
    assert [k.name for k in keys] == ["Basis", "Mine"] and len(keys["Mine"].data) == count
    assert [tuple(scan.data.vertices[i].co) for i in (5, 7)] == at
    assert keys["Mine"].data[5].co.x == pytest.approx(at[0][0] + 1.0)
    assert scan.vertex_groups["Hair"].weight(7) == pytest.approx(0.5)


def test_opening_lips_requires_landmarks():
    bpy.ops.mesh.primitive_uv_sphere_add()
    assert not bpy.ops.facemime.open_lips.poll()
    add_head(bpy.context)
    with pytest.raises(RuntimeError, match="already separate"):
        bpy.ops.facemime.open_lips()


@pytest.fixture
def hollow(scan):
    """The scan with open lips and nothing behind them."""
    open_lips(scan)
    landmarks = read_landmarks(scan)
    work = bmesh.new()
    work.from_mesh(scan.data)
    bmesh.ops.delete(work, geom=[face for face in work.faces if face.material_index == 1], context="FACES_ONLY")
    bmesh.ops.delete(work, geom=[vertex for vertex in work.verts if not vertex.link_faces], context="VERTS")
    work.to_mesh(scan.data)
    work.free()
    scan.data.materials.pop()
    write_landmarks(scan.data, landmarks)  # the pocket's vertices were the last
    propose_head_regions(scan)
    return scan


def behind_lips(head):
    """Whether a ray between the lips, which the mouth opens by their regions, hits something dark near them."""
    places, landmarks = read_vertices(head.data), read_landmarks(head)
    places[:, 1] += 0.3 * UNIT * (read_regions(head)[2] > 0.5)
    open_mouth = places[landmarks[MOUTH_INNER_UPPER[1]]] + (0.0, 0.15 * UNIT, 0.0)
    tree = BVHTree.FromPolygons(places.tolist(), [face.vertices[:] for face in head.data.polygons])
    hit, _, face, _ = tree.ray_cast((open_mouth - (0.0, 0.0, UNIT)).tolist(), (0.0, 0.0, 1.0))
    return hit is not None and head.data.materials[head.data.polygons[face].material_index] == mouth_material()


def test_lips_with_nothing_behind_them_get_a_dark_pocket_on_request(hollow):
    assert "open_lips" in [finding.step for finding in check_object(hollow)]
    before, face = read_vertices(hollow.data), read_landmarks(hollow)
    assert not behind_lips(hollow)
    assert bpy.ops.facemime.open_lips() == {"FINISHED"}
    np.testing.assert_array_equal(read_vertices(hollow.data)[: len(before)], before)
    np.testing.assert_array_equal(read_landmarks(hollow), face)
    assert behind_lips(hollow)
    assert "open_lips" not in [finding.step for finding in check_object(hollow)]
    with pytest.raises(RuntimeError, match="already separate"):
        bpy.ops.facemime.open_lips()


def test_teeth_behind_open_lips_are_an_inside(hollow):
    lips = read_vertices(hollow.data)[read_landmarks(hollow)[MOUTH_INNER_UPPER[1]]]
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.1 * UNIT, location=to_blender(lips + (0.0, 0.0, 0.2 * UNIT)).tolist())
    teeth = bpy.context.active_object
    teeth[HEAD_PROPERTY] = hollow
    assert "open_lips" not in [finding.step for finding in check_object(hollow)]


def test_the_inside_of_a_built_in_head_is_not_missing():
    assert check_object(add_head(bpy.context)) == []
