"""The cut through the skin over an eye, and lids that shut over it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from facemime.core.deform.head_deformer import head_deformer
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import LOWER_LIDS, MIRROR, UPPER_LIDS
from facemime.core.heads.bind import bind_landmarks
from facemime.core.heads.eyeballs import EYES, LID_THICKNESS, EyeballContact, eye_outline, fit_eyeball
from facemime.core.heads.lids import coarse_edges, cut_eye, eyes_joined
from facemime.core.heads.proposal import propose_regions
from facemime.core.heads.rig import HeadRig
from facemime.core.mesh.surface import SurfaceGraph
from tests.helpers.scans import HEAD, UNIT, cut_apart, padded, scanned

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def scan():
    """Vertices, faces and landmarks of a scan."""
    places, faces = scanned()
    return places, faces, bind_landmarks(places, faces).landmarks


@pytest.fixture(scope="module")
def cuts(scan):
    """The cuts of the right and the left eye."""
    places, faces, landmarks = scan
    return [cut_eye(places, faces, eye_outline(places, landmarks, eye)) for eye in EYES]


def rim_of(cut, places):
    """Return the places of the rim, (N, 3)."""
    ends = places[cut.edges]
    new = ends[:, 0] + cut.shares[:, None] * (ends[:, 1] - ends[:, 0])
    return np.concatenate([places, new])[cut.rim]


def area(polygon):
    """Area of a polygon (N, 3), seen from the front."""
    x, y = polygon[:, 0], polygon[:, 1]
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def test_a_scans_eyes_are_one_skin_with_their_lids_and_a_modelled_heads_are_not(scan):
    assert eyes_joined(*scan) == [True, True]
    assert eyes_joined(HEAD.vertices, HEAD.faces, HEAD.landmarks) == [False, False]


def test_open_and_joined_eyes_are_distinguished(scan):
    places, faces, landmarks = scan
    cut = cut_eye(places, faces, eye_outline(places, landmarks, EYES[1]))
    hole = faces[~np.isin(faces, cut.within).any(axis=1)]
    assert eyes_joined(places, hole, landmarks) == [True, False]


def test_coincident_landmarks_are_not_an_eye(scan):
    places, faces, landmarks = scan
    nowhere = np.full_like(landmarks, landmarks[0])
    assert eyes_joined(places, faces, nowhere) == [False, False]
    with pytest.raises(HeadError, match="corner of an eye"):
        eye_outline(places, nowhere, EYES[0])


def test_the_outline_of_a_modelled_eye_is_near_its_lids():
    for eye in EYES:
        outline = eye_outline(HEAD.vertices, HEAD.landmarks, eye)
        local = outline.to_local(HEAD.vertices[HEAD.landmarks[eye]].astype(float))
        np.testing.assert_allclose(local[[0, 3]], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], atol=1e-6)
        assert np.abs(outline.depth_within(local)).max() < 0.04
        np.testing.assert_allclose(outline.to_local(outline.from_local(local)), local, atol=1e-6)


@settings(max_examples=60)
@given(arrays(float, (4, 3), elements=st.floats(-0.4, 0.4)))
def test_for_any_lid_landmarks_the_outline_is_an_open_eye_between_the_corners(noise):
    points = HEAD.vertices[HEAD.landmarks].astype(float)
    width = np.linalg.norm(points[EYES[0][3]] - points[EYES[0][0]])
    points[EYES[0][[1, 2, 4, 5]]] += width * noise
    outline = eye_outline(points, np.arange(66), EYES[0])
    line = np.zeros((19, 3))
    line[:, 0] = np.linspace(0.05, 0.95, 19)
    assert (outline.depth_within(line) > 0.0).all()
    assert (outline.depth_within(line + (0.0, 0.8, 0.0)) < 0.0).all()


def test_the_cut_is_one_closed_line_on_the_outline_from_the_outer_corner_over_the_upper_lid(scan, cuts):
    places, _, _ = scan
    for cut in cuts:
        assert len(set(cut.rim.tolist())) == len(cut.rim)
        assert ((cut.shares > 0.0) & (cut.shares < 1.0)).all()
        local = cut.outline.to_local(rim_of(cut, places))
        assert np.abs(cut.outline.depth_within(local)).max() < 0.02
        assert local[0, 0] < 0.05 and local[cut.inner, 0] > 0.95
        upper, lower = local[1 : cut.inner], local[cut.inner + 1 :]
        assert upper[:, 1].mean() > 0.1 and lower[:, 1].mean() < -0.02
        assert (cut.outline.depth_within(cut.outline.to_local(places[cut.within])) > 0.0).all()


@pytest.mark.thorough
def test_the_parts_of_a_cut_skin_have_its_area_and_meet_in_the_rim(scan, cuts):
    def areas(points, polygons):
        return sum(np.linalg.norm(sum(np.cross(points[a], points[b]) for a, b in pairs(p))) / 2.0 for p in polygons)

    def pairs(polygon):
        return zip(polygon, polygon[1:] + polygon[:1], strict=True)

    flat = np.array(scan[0])
    flat[:, 2] = 0.0
    whole = [face.tolist() for face in scan[1]]
    for cut in cuts:
        points, skin, eye = cut_apart(flat, whole, cut)
        assert areas(points, skin) + areas(points, eye) == pytest.approx(areas(flat, whole), rel=1e-9)
        assert areas(points, eye) == pytest.approx(area(points[cut.rim]), rel=1e-9)
        border = {frozenset(pair) for polygon in eye for pair in pairs(polygon)} & {
            frozenset(pair) for polygon in skin for pair in pairs(polygon)
        }
        assert border == {frozenset(pair) for pair in pairs(cut.rim.tolist())}


def test_the_mirror_image_of_a_scan_is_cut_in_the_mirror_image(scan, cuts):
    places, faces, landmarks = scan
    mirrored = landmarks[MIRROR]
    for eye, cut in zip(EYES, reversed(cuts), strict=True):
        other = cut_eye(places * FLIP, faces[:, ::-1], eye_outline(places * FLIP, mirrored, eye))
        np.testing.assert_allclose(rim_of(other, places * FLIP), rim_of(cut, places) * FLIP, atol=1e-9 * UNIT)
        assert other.inner == cut.inner
        np.testing.assert_allclose(other.eyeball[:3] * FLIP, cut.eyeball[:3], atol=1e-6 * UNIT)


def test_the_cut_does_not_depend_on_the_order_of_vertices_and_faces(scan, cuts):
    places, faces, landmarks = scan
    rng = np.random.default_rng(0)
    order = rng.permutation(len(places))
    number = np.argsort(order)
    shuffled = number[faces][rng.permutation(len(faces))]
    for eye, cut in zip(EYES, cuts, strict=True):
        other = cut_eye(places[order], shuffled, eye_outline(places[order], number[landmarks], eye))
        np.testing.assert_allclose(rim_of(other, places[order]), rim_of(cut, places), atol=1e-12)


def test_the_lids_lie_on_a_sphere_and_the_eye_just_behind_it(scan, cuts):
    places, _, _ = scan
    for cut in cuts:
        centre, radius = cut.eyeball[:3], cut.eyeball[3]
        away = np.linalg.norm(rim_of(cut, places) - centre, axis=1) / radius
        assert away.min() > 1.0 - LID_THICKNESS and np.median(away) < 1.03
        eye = cut.project_to_eye(places[cut.within])
        np.testing.assert_allclose(np.linalg.norm(eye - centre, axis=1), (1.0 - LID_THICKNESS) * radius, rtol=1e-9)
        moved = cut.outline.to_local(eye) - cut.outline.to_local(places[cut.within])
        np.testing.assert_allclose(moved[:, :2], 0.0, atol=1e-9)
        beyond = cut.outline.to_local(cut.behind_lids(rim_of(cut, places), 0.1))
        assert (cut.outline.depth_within(beyond) < -0.02).all()


def test_cut_lids_shut_over_the_eye_and_stay_in_front_of_it(scan):
    points, polygons, landmarks = scan[0], [face.tolist() for face in scan[1]], scan[2].copy()
    outlines = [eye_outline(points, landmarks, eye) for eye in EYES]
    cuts = []
    for eye, outline in zip(EYES, outlines, strict=True):
        cut = cut_eye(points, padded(polygons), outline)
        points, polygons, _ = cut_apart(points, polygons, cut)
        landmarks[eye] = cut.rim[cut.landmark_places(points[cut.rim])]
        cuts.append(cut)
    faces = padded(polygons)
    assert eyes_joined(points, faces, landmarks) == [False, False]
    regions = propose_regions(points, faces, landmarks)
    balls = np.array([cut.eyeball for cut in cuts])
    rig = HeadRig(points, landmarks, regions, points[landmarks[8]], balls, faces=faces)
    shut = np.zeros((66, 3))
    for upper, lower in zip(UPPER_LIDS, LOWER_LIDS, strict=True):
        shut[upper] = points[landmarks[lower]] - points[landmarks[upper]]
    moved = head_deformer(rig).deform(shut)
    EyeballContact(points, regions.sum(axis=0), balls).resolve(moved)
    skin = np.unique(faces[faces >= 0])
    for cut in cuts:
        assert area(moved[cut.rim]) < 0.05 * area(points[cut.rim])
        away = np.linalg.norm(moved[skin] - cut.eyeball[:3], axis=1)
        assert away.min() > (1.0 - LID_THICKNESS) * cut.eyeball[3]


def test_a_coarse_mesh_is_refused_with_its_long_edges(scan):
    places, faces, landmarks = scan
    outline = eye_outline(places, landmarks, EYES[0])
    assert len(coarse_edges(SurfaceGraph(places, faces), outline)) < 60
    grid = np.array([[x, y, 0.0] for y in range(5) for x in range(5)])
    squares = np.array([[i, i + 1, i + 6, i + 5] for i in range(19) if i % 5 < 4])
    coarse = outline.from_local((grid - (2.0, 2.0, 0.0)) * 0.45 + (0.5, 0.0, 0.0))
    found = coarse_edges(SurfaceGraph(coarse, squares), outline)
    assert len(found) == 24
    for faces in (squares, squares[:1]):
        with pytest.raises(HeadError, match="Subdivide"):
            cut_eye(coarse, faces, outline)


def test_a_hole_in_the_eye_is_refused_with_advice(scan, cuts):
    places, faces, _ = scan
    for vertex in (cuts[0].within[0], cuts[0].edges[0, 0]):
        torn = faces[~(faces == vertex).any(axis=1)]
        with pytest.raises(HeadError, match="Fill them"):
            cut_eye(places, torn, cuts[0].outline)


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_the_sphere_of_an_eye_is_recovered_from_its_vertices(seed):
    rng = np.random.default_rng(seed)
    centre, radius = rng.normal(0.0, 5.0, 3), rng.uniform(0.1, 10.0)
    cap = rng.normal(0.0, 0.4, (30, 3)) - (0.0, 0.0, 1.0)
    cap *= (1.0 - LID_THICKNESS) * radius / np.linalg.norm(cap, axis=1, keepdims=True)
    np.testing.assert_allclose(fit_eyeball(centre + cap), [*centre, radius], rtol=1e-6, atol=1e-6)
