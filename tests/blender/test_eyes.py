"""Opening the joined eyes of a scan, so that the lids close over eyes that stay in place."""

import bpy
import numpy as np
import pytest

from facemime.blender.frames import to_blender
from facemime.blender.heads.binding import check_object
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import eye_vertices, read_faces, read_landmarks, read_regions, read_vertices
from facemime.blender.rigs import read_rig
from facemime.core.base.landmarks import EYE_LEFT, EYE_RIGHT, LOWER_LIDS, MIRROR, UPPER_LIDS
from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.surface import SurfaceGraph
from facemime.core.takes.neutral import calibrate
from tests.helpers.scans import UNIT, scanned
from tests.helpers.seen import seen
from tests.helpers.takes import make_take

WORDS = "The eyes are joined to their lids, so they cannot shut."


def blinks(rig, wide=0.0):
    """Return the vertices at rest, and with lids half closed, closed, and opened by `wide` more than at rest."""
    rest = rig.vertices[rig.landmarks].astype(float)
    rest /= UNIT
    shapes = np.tile(rest, (40, 1, 1))
    gap = rest[LOWER_LIDS] - rest[UPPER_LIDS]
    for frame, share in ((30, 0.5), (31, 1.0), (32, 1.0), (33, 1.0), (34, -wide)):
        shapes[frame, UPPER_LIDS] += share * gap
    take = make_take(shapes)
    driver = HeadDriver(rig, calibrate(take))
    return [driver.frame(take.result(frame)).vertices for frame in (10, 30, 32, 34)]


def seen_of_eyes(obj, vertices):
    """Return how many pixels of an image of each eye show the eye, and how many show nothing."""
    faces, landmarks = read_faces(obj.data), read_landmarks(obj)
    of_eye = np.isin(faces, eye_vertices(obj)) | (faces < 0)
    shown = []
    for eye in (EYE_RIGHT, EYE_LEFT):
        picture = seen(vertices, faces, read_vertices(obj.data)[landmarks[eye]].mean(axis=0), 0.25 * UNIT)
        shown.append((int(of_eye.all(axis=1)[picture[picture >= 0]].sum()), int((picture < 0).sum())))
    return np.array(shown)


def test_joined_eyes_of_a_scan_are_reported_until_they_are_opened(scan):
    assert WORDS in [finding.problem for finding in check_object(scan)]
    assert bpy.ops.facemime.check_head() == {"FINISHED"}
    assert [line.step for line in bpy.context.window_manager.facemime.findings] == ["open_lips", "open_eyes"]
    assert bpy.ops.facemime.open_eyes() == {"FINISHED"}
    assert [line.step for line in bpy.context.window_manager.facemime.findings] == ["open_lips"]
    assert bpy.ops.facemime.open_lips() == {"FINISHED"}
    assert check_object(scan) == [] and len(bpy.context.window_manager.facemime.findings) == 0
    with pytest.raises(RuntimeError, match="already separate"):
        bpy.ops.facemime.open_eyes()


@pytest.mark.thorough
def test_lids_close_over_static_eyes_and_open_without_gaps(scan):
    bpy.ops.facemime.open_eyes()
    rig = read_rig(scan)
    rest, half, shut, wide = blinks(rig, wide=0.3)
    eyes = eye_vertices(scan)
    for vertices in (half, shut, wide):
        np.testing.assert_array_equal(vertices[eyes], rig.vertices[eyes])
    at_rest, at_half, at_shut, at_wide = (seen_of_eyes(scan, v) for v in (rest, half, shut, wide))
    assert (at_rest[:, 0] > 1000).all()
    assert (at_half[:, 0] < 0.6 * at_rest[:, 0]).all()
    assert (at_shut[:, 0] < 0.05 * at_rest[:, 0]).all()
    assert (at_wide[:, 0] > 1.15 * at_rest[:, 0]).all()
    assert not np.concatenate([at_rest, at_half, at_shut, at_wide])[:, 1].any()


@pytest.mark.thorough
def test_a_coarse_mesh_is_subdivided_around_its_eyes_so_that_they_close(coarse_scan):
    landmarks = read_landmarks(coarse_scan)
    others = np.setdiff1d(np.arange(66), [*EYE_RIGHT, *EYE_LEFT])
    places = read_vertices(coarse_scan.data)[landmarks[others]]
    bpy.ops.facemime.open_eyes()
    np.testing.assert_array_equal(read_vertices(coarse_scan.data)[read_landmarks(coarse_scan)[others]], places)
    rest, _, shut, _ = blinks(read_rig(coarse_scan))
    before, after = seen_of_eyes(coarse_scan, rest)[:, 0], seen_of_eyes(coarse_scan, shut)[:, 0]
    assert (after < 0.05 * before).all()


@pytest.mark.thorough
def test_eyes_stay_out_of_regions_that_are_proposed_or_smoothed_later(scan):
    bpy.ops.facemime.open_eyes()
    eyes = eye_vertices(scan)
    assert len(eyes) > 100
    for step in ("open_lips", "propose_regions", "smooth_regions"):
        getattr(bpy.ops.facemime, step)()
        assert not read_regions(scan)[:, eyes].any()


def test_lid_landmarks_are_bound_to_the_rim_with_upper_and_lower_in_different_regions(scan):
    before = read_landmarks(scan)
    places = read_vertices(scan.data)
    bpy.ops.facemime.open_eyes()
    landmarks, regions = read_landmarks(scan), read_regions(scan)
    lids = np.concatenate([EYE_RIGHT, EYE_LEFT])
    assert len(set(landmarks.tolist())) == 66
    moved = np.linalg.norm(read_vertices(scan.data)[landmarks] - places[before], axis=1)
    assert moved[lids].max() < 0.15 * UNIT and np.delete(moved, lids).max() == 0.0
    rim = set(SurfaceGraph(read_vertices(scan.data), skin_faces(scan)).openings()[1].tolist())
    rim |= set(SurfaceGraph(read_vertices(scan.data), skin_faces(scan)).openings()[2].tolist())
    assert rim.issuperset(landmarks[lids].tolist())
    assert (regions[0, landmarks[UPPER_LIDS]] > 0.9).all() and (regions[1, landmarks[LOWER_LIDS]] > 0.9).all()


def skin_faces(obj):
    """Return (F, K) faces without a vertex of an eye."""
    faces = read_faces(obj.data)
    return faces[~np.isin(faces, eye_vertices(obj)).any(axis=1)]


@pytest.mark.thorough
def test_binding_again_finds_the_rims_of_the_lids(scan):
    bpy.ops.facemime.open_eyes()
    lids = np.concatenate([EYE_RIGHT, EYE_LEFT])
    bpy.ops.facemime.bind_landmarks()
    openings = SurfaceGraph(read_vertices(scan.data), skin_faces(scan)).openings()
    assert np.isin(read_landmarks(scan)[lids], np.concatenate(openings[1:3])).all()
    assert WORDS not in [finding.problem for finding in check_object(scan)]


def test_opening_the_eyes_leaves_no_holes(scan):
    border = np.count_nonzero(SurfaceGraph(read_vertices(scan.data), read_faces(scan.data)).faces_at == 1)
    bpy.ops.facemime.open_eyes()
    faces_at = SurfaceGraph(read_vertices(scan.data), read_faces(scan.data)).faces_at
    assert np.count_nonzero(faces_at == 1) == border and faces_at.max() == 2
    assert not scan.data.validate()


@pytest.mark.thorough
def test_textures_of_the_skin_stay_in_place(scan):
    layer = scan.data.uv_layers.new(name="Picture")
    for loop in scan.data.loops:
        place = scan.data.vertices[loop.vertex_index].co
        layer.data[loop.index].uv = (5.0 * place.x, 5.0 * place.z)
    bpy.ops.facemime.open_eyes()
    eyes = set(eye_vertices(scan).tolist())
    layer = scan.data.uv_layers["Picture"]
    for face in scan.data.polygons:
        if eyes.isdisjoint(face.vertices):
            for vertex, loop in zip(face.vertices, face.loop_indices, strict=True):
                place = scan.data.vertices[vertex].co
                assert layer.data[loop].uv[:] == pytest.approx((5.0 * place.x, 5.0 * place.z), abs=1e-5)
    pictured = np.array([layer.data[i].uv[:] for face in scan.data.polygons for i in face.loop_indices])
    assert np.isfinite(pictured).all() and pictured.any(axis=1).all()


@pytest.mark.thorough
def test_shape_keys_vertex_groups_and_materials_survive_the_cut(scan):
    scan.shape_key_add(name="Basis")
    key = scan.shape_key_add(name="Mine")
    for point in key.data:
        point.co.x += 1.0
    scan.vertex_groups.new(name="Bone").add(range(len(scan.data.vertices)), 0.5, "REPLACE")
    for name in ("One", "Two"):
        scan.data.materials.append(bpy.data.materials.new(name))
    for face in scan.data.polygons:
        face.material_index = 1
    bpy.ops.facemime.open_eyes()
    count = len(scan.data.vertices)
    keys = scan.data.shape_keys.key_blocks
    assert [k.name for k in keys] == ["Basis", "Mine"] and len(keys["Mine"].data) == count
    for mine, basis, vertex in zip(keys["Mine"].data, keys["Basis"].data, scan.data.vertices, strict=True):
        assert mine.co.x == pytest.approx(basis.co.x + 1.0, abs=1e-6)
        assert tuple(basis.co) == pytest.approx(tuple(vertex.co), abs=1e-6)
    assert all(scan.vertex_groups["Bone"].weight(i) == pytest.approx(0.5) for i in range(count))
    assert {face.material_index for face in scan.data.polygons} == {1}


def test_opening_the_eyes_is_a_single_undo_step(scan):
    before = read_vertices(scan.data)
    landmarks = read_landmarks(scan)
    bpy.ops.ed.undo_push(message="bound")
    bpy.ops.facemime.open_eyes()
    bpy.ops.ed.undo_push(message="opened")
    bpy.ops.ed.undo()
    obj = bpy.data.objects["Scan"]
    np.testing.assert_array_equal(read_vertices(obj.data), before)
    np.testing.assert_array_equal(read_landmarks(obj), landmarks)
    assert len(eye_vertices(obj)) == 0 and WORDS in [finding.problem for finding in check_object(obj)]


@pytest.mark.thorough
def test_a_mirrored_scan_gets_mirrored_eyes(scan):
    places, faces = scanned()
    landmarks = read_landmarks(scan)
    mesh = bpy.data.meshes.new("Other")
    mesh.from_pydata(to_blender(places * (-1.0, 1.0, 1.0)).tolist(), [], faces[:, ::-1].tolist())
    other = bpy.data.objects.new("Other", mesh)
    bpy.context.scene.collection.objects.link(other)
    other.data["facemime_landmarks"] = [int(v) for v in landmarks[MIRROR]]
    bpy.ops.facemime.open_eyes()
    bpy.context.view_layer.objects.active = other
    bpy.ops.facemime.open_eyes()
    mine, theirs = (read_vertices(obj.data)[read_landmarks(obj)] for obj in (scan, other))
    np.testing.assert_allclose(theirs[MIRROR] * (-1.0, 1.0, 1.0), mine, atol=1e-6)
    assert len(other.data.vertices) == len(scan.data.vertices)


def test_missing_landmarks_open_eyes_and_holes_are_errors_and_nothing_is_cut(scan):
    count = len(scan.data.vertices)
    landmarks = read_landmarks(scan)
    middle = read_vertices(scan.data)[landmarks[EYE_RIGHT]].mean(axis=0)
    vertices = read_vertices(scan.data)
    faces = read_faces(scan.data)
    hit = int(np.argmin(np.linalg.norm(vertices - middle, axis=1)))
    kept = faces[~(faces == hit).any(axis=1)]
    scan.data.clear_geometry()
    scan.data.from_pydata(to_blender(vertices).tolist(), [], kept.tolist())
    with pytest.raises(RuntimeError, match="holes at the eyes"):
        bpy.ops.facemime.open_eyes()
    assert len(scan.data.vertices) == count and not eye_vertices(scan).size
    add_head(bpy.context)
    with pytest.raises(RuntimeError, match="already separate"):
        bpy.ops.facemime.open_eyes()
    bpy.ops.mesh.primitive_uv_sphere_add()
    assert not bpy.ops.facemime.open_eyes.poll()
