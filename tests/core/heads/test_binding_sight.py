"""The face that the tracker sees on a mesh, and how it guides the binding."""

import cv2
import numpy as np
import pytest

from facemime.core.errors import HeadError
from facemime.core.face.landmarks import (
    EYE_CORNERS,
    EYE_LEFT,
    EYE_RIGHT,
    INNER,
    LIPS,
    OUTER_EYE_CORNERS,
    from_ibug,
    lid_gaps,
)
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.files.assets import ASSETS
from facemime.core.heads.bind import MARKS, bind_landmarks
from facemime.core.heads.built_in import load_head
from facemime.core.heads.facegen import read_tri
from facemime.core.heads.portrait import SIZE, Paint, Sitter
from facemime.core.heads.sight import look
from facemime.core.mesh.surface import triangulate
from facemime.core.mesh.triangles import rasterise
from tests.helpers.scans import scanned
from tests.helpers.thorough import first_of

HEAD = load_head()
VERTICES = HEAD.vertices.astype(float)
POINTS = VERTICES[HEAD.landmarks]
UNIT = float(np.linalg.norm(np.subtract(*POINTS[OUTER_EYE_CORNERS])))
LIDS = np.concatenate([EYE_RIGHT, EYE_LEFT])


def posed(**strengths: float) -> np.ndarray:
    """The built-in head with some of its units; units for both sides are given without a side."""
    sides = {unit: strengths.get(unit.removesuffix("Left").removesuffix("Right"), 0.0) for unit in HEAD.unit_names}
    return VERTICES + np.tensordot([sides[unit] for unit in HEAD.unit_names], HEAD.units.astype(float), 1)


def strange(chin: float = 1.3) -> np.ndarray:
    """The head made wider, with a longer or shorter lower face and a smirk, so that no similarity fits."""
    places = posed(mouthDimple=0.5, browInnerUp=0.4) * [1.15, 1.0, 1.0]
    nose = POINTS[from_ibug([33])[0], 1]
    places[:, 1] += (chin - 1.0) * np.maximum(places[:, 1] - nose, 0.0)
    return places


def off(places: np.ndarray, found: np.ndarray, part: np.ndarray) -> float:
    """Mean distance in the plane of the face from the head's own landmarks, in outer-eye distances."""
    points = places[HEAD.landmarks]
    unit = np.linalg.norm(np.subtract(*points[OUTER_EYE_CORNERS]))
    return float(np.linalg.norm((found - points)[part, :2], axis=1).mean() / unit)


def ball(radii: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """An ellipsoid."""
    down, around = np.meshgrid(np.linspace(0.0, np.pi, 40), np.linspace(0.0, 2.0 * np.pi, 80))
    places = np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)], axis=-1)
    number = np.arange(down.size).reshape(down.shape)
    faces = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    return places.reshape(-1, 3) * radii, faces.reshape(-1, 4)


def block() -> tuple[np.ndarray, np.ndarray]:
    """A cube with subdivided sides."""
    places, faces = ball((1.0, 1.0, 1.0))
    return places / np.abs(places).max(axis=1, keepdims=True), faces


def test_a_face_is_seen_on_a_bare_mesh_near_its_own_landmarks():
    places = strange()
    sight = look(places, HEAD.faces)
    assert sight is not None and sight.sure
    assert off(places, sight.points, EYE_CORNERS) < 0.03
    assert off(places, sight.points, LIDS) < 0.04
    assert off(places, sight.points, LIPS) < 0.05


def test_landmarks_that_are_seen_lie_on_the_surface():
    places = strange()
    sight = look(places, HEAD.faces)
    assert sight is not None
    away = np.linalg.norm(places[:, None] - sight.points[INNER], axis=2).min(axis=0)
    assert np.median(away) < 0.05 * UNIT and away.max() < 0.15 * UNIT


def test_a_bowed_and_turned_head_is_viewed_from_in_front():
    turn = euler_to_matrix(*np.radians((20.0, -25.0, 15.0)))
    sight = look(VERTICES @ turn.T, HEAD.faces)
    assert sight is not None and sight.sure
    assert off(VERTICES, sight.points @ turn, INNER) < 0.05


def test_no_face_is_seen_on_a_head_that_is_upside_down_or_looks_away():
    for angles in ((0, 0, 180), (0, 180, 0), (90, 0, 0), (-90, 0, 0)):
        sight = look(VERTICES @ euler_to_matrix(*np.radians(angles)).T, HEAD.faces)
        assert sight is None or not sight.sure


@pytest.mark.parametrize("angles", first_of([(90, 0, 0), (0, 0, 180), (0, 180, 0), (0, 0, -90)]))
def test_a_stylised_head_in_another_attitude_is_bound_upright(angles):
    places, turn = strange(), euler_to_matrix(*np.radians(angles))
    binding = bind_landmarks(places @ turn.T, HEAD.faces)
    assert binding.sure and binding.clarity > 0.5
    assert off(places, places[binding.landmarks], INNER) < 0.04
    assert np.trace(binding.rotation @ turn) > 1.0 + 2.0 * np.cos(np.radians(15.0))


def test_the_eyes_of_a_scan_without_openings_are_found_without_marks():
    places, faces = scanned()
    found = places[bind_landmarks(places, faces).landmarks]
    assert np.linalg.norm((found - POINTS)[LIDS, :2], axis=1).mean() < 0.03 * UNIT


@pytest.mark.thorough
@pytest.mark.parametrize(
    "shape",
    [
        ball((1.4, 2.0, 0.8)),
        *(
            pytest.param(shape, marks=pytest.mark.thorough)
            for shape in (ball((1, 1, 1)), ball((0.8, 1.2, 1.0)), block())
        ),
    ],
)
def test_a_mesh_without_a_visible_face_or_the_shape_of_a_head_is_refused(shape):
    with pytest.raises(HeadError, match="No face was found"):
        bind_landmarks(*shape)


def test_an_unusual_face_is_bound_with_a_request_for_the_four_marks_that_help_most():
    binding = bind_landmarks(strange(chin=0.5), HEAD.faces)
    assert not binding.sure and len(set(binding.wanted)) == 4 and set(binding.wanted) <= set(MARKS)
    marked = {number: int(HEAD.landmarks[from_ibug([number])[0]]) for number in binding.wanted}
    again = bind_landmarks(strange(chin=0.5), HEAD.faces, marked)
    assert again.sure and again.wanted == ()
    for number, vertex in marked.items():
        assert again.landmarks[from_ibug([number])[0]] == vertex


def test_a_visible_face_helps_to_bind_unmarked_landmarks():
    places = strange()
    few = {number: int(HEAD.landmarks[from_ibug([number])[0]]) for number in (36, 45, 30, 8)}
    binding = bind_landmarks(places, HEAD.faces, few)
    assert binding.clarity > 0.5
    assert off(places, places[binding.landmarks], LIPS) < 0.04


@pytest.mark.parametrize(
    ("strengths", "problem"),
    [
        ({}, None),
        ({"browInnerUp": 0.5}, None),
        ({"eyeBlink": 1.0}, "The eyes are shut at rest"),
        ({"jawOpen": 0.35}, "The mouth is open at rest"),
        ({"mouthSmile": 1.0}, "The face smiles at rest"),
    ],
)
def test_shut_eyes_an_open_mouth_and_a_smile_are_distinguished_from_a_neutral_face(strengths, problem):
    findings = bind_landmarks(posed(**strengths), HEAD.faces).findings
    assert [finding.problem.split(",")[0] for finding in findings] == ([problem] if problem else [])
    assert all(finding.remedy.endswith(".") for finding in findings)


def test_places_on_a_portrait_are_places_on_the_mesh():
    places, faces = ball((1.0, 1.0, 1.0))
    portrait = Sitter(places, faces).portrait()
    pixels = np.array([[SIZE / 2.0, SIZE / 2.0], [0.3 * SIZE, 0.4 * SIZE], [2.0, 2.0]])
    found = portrait.places(pixels)
    np.testing.assert_allclose(np.linalg.norm(found[:2], axis=1), 1.0, atol=0.02)
    assert (found[:2, 2] < 0.0).all() and np.isnan(found[2, 2])


@pytest.mark.parametrize("faces", [HEAD.faces, triangulate(HEAD.faces)[:, ::-1]], ids=["outwards", "inwards"])
def test_normals_may_point_inwards(faces):
    portrait = Sitter(VERTICES, faces).portrait()
    skin = np.isfinite(portrait.depth) & ~portrait.hollow
    assert np.count_nonzero(portrait.hollow) < 0.05 * np.count_nonzero(skin)


def test_only_empty_sockets_get_eyes():
    portrait = Sitter(VERTICES, HEAD.faces).portrait(POINTS[INNER].mean(axis=0)[:2], 1.3 * UNIT)
    eyes = np.stack(
        [(POINTS[eye].mean(axis=0)[:2] - portrait.corner) / portrait.pixel for eye in (EYE_RIGHT, EYE_LEFT)]
    )
    painted = portrait.with_eyes(eyes, UNIT / portrait.pixel)
    changed = np.argwhere(painted.image != portrait.image)[:, ::-1]
    assert len(changed) > 200
    assert np.linalg.norm(changed[:, None] - eyes, axis=2).min(axis=1).max() < 0.2 * UNIT / portrait.pixel
    whole, faces = ball((1.0, 1.0, 1.0))
    plain = Sitter(whole, faces).portrait()
    np.testing.assert_array_equal(plain.with_eyes(eyes, 50.0).image, plain.image)


def test_triangles_that_leave_the_image_are_clipped():
    points = np.array([[-300.0, -300.0], [900.0, -300.0], [-300.0, 900.0]])
    drawn = rasterise(points, np.array([1.0, 1.0, 2.0]), np.array([[0, 1, 2]]), 64)
    assert len(drawn.pixel) == 64 * 64
    np.testing.assert_allclose(drawn.barycentric.sum(axis=1), 1.0, atol=1e-5)


@pytest.mark.thorough
def test_many_large_triangles_are_drawn_within_limits():
    rng = np.random.default_rng(0)
    points = rng.uniform(-500.0, 700.0, (3000, 2))
    drawn = rasterise(points, rng.uniform(size=3000), np.arange(9000).reshape(-1, 3) % 3000, 256)
    assert np.isfinite(drawn.depth).any()


def test_meshes_without_extent_or_faces_are_not_faces():
    assert look(np.zeros((80, 3)), np.array([[0, 1, 2]])) is None
    assert look(VERTICES, np.empty((0, 4), int)) is None


def test_portraits_are_grey_images_that_a_tracker_accepts():
    image = Sitter(VERTICES, HEAD.faces).portrait().image
    assert image.dtype == np.uint8 and image.shape == (SIZE, SIZE)
    assert cv2.Laplacian(image, cv2.CV_64F).std() > 1.0


def test_a_face_is_seen_more_clearly_in_its_own_colours():
    jane = read_tri(ASSETS / "facegen" / "Jane.tri")
    image = cv2.imread(str(ASSETS / "facegen" / "Jane.jpg"), cv2.IMREAD_GRAYSCALE)
    uv = np.abs(jane.uv - (0.0, 1.0)) * (np.array(image.shape[::-1]) - 1)
    places = jane.vertices.astype(float)
    clay, coloured = look(places, jane.faces), look(places, jane.faces, Paint(image, uv.astype(np.float32)))
    assert coloured.painted and not clay.painted and coloured.clarity > clay.clarity
    # The lids of a mesh of clay whose eyes are painted are seen half-way over them.
    assert lid_gaps(coloured.points).min() > 1.5 * lid_gaps(clay.points).min()


def test_a_mesh_without_a_face_in_its_colours_is_seen_as_of_clay():
    grey = Paint(np.full((8, 8), 128, np.uint8), np.zeros((*HEAD.faces.shape, 2), np.float32))
    assert look(VERTICES, HEAD.faces, grey).clarity >= look(VERTICES, HEAD.faces).clarity
