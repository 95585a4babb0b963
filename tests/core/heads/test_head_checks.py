"""Checks of a head find joined lips, misplaced lids, and landmarks and regions that cannot drive it."""

import numpy as np
import pytest

from facemime.core.errors import HeadError
from facemime.core.face.landmarks import LOWER_LIDS, UPPER_LIDS, from_ibug
from facemime.core.heads.bind import bind_head, bind_landmarks
from facemime.core.heads.checks import check_head
from facemime.core.heads.proposal import propose_regions
from facemime.core.heads.regions import hold_landmarks
from lab.bench.heads import ict_people
from lab.training.data import DATA, has_heads
from tests.helpers.built_in import HEAD, POINTS, UNIT, VERTICES, stylised

LIDS_MISPLACED = "The landmarks of the lids seem to lie on a brow or on lashes."


def test_a_valid_head_has_no_findings():
    assert check_head(VERTICES, HEAD.faces, HEAD.landmarks, HEAD.regions) == []


def test_the_check_reports_problems_and_remedies():
    twins = HEAD.landmarks.copy()
    twins[0] = twins[1]
    weights = HEAD.regions.copy()
    weights[:, HEAD.landmarks[from_ibug([30])]] = 0.0
    assert "Landmarks 30 lie in no region" in check_head(VERTICES, HEAD.faces, HEAD.landmarks, weights)[0].problem
    weights[2] = 0.0
    findings = check_head(VERTICES, HEAD.faces, twins, weights)
    told = " ".join(finding.problem for finding in findings)
    assert "Landmarks 0, 1 share vertices" in told and "The region lower is empty" in told
    assert all(finding.remedy.endswith(".") for finding in findings)


@pytest.mark.parametrize("vertex", [-2, len(VERTICES)])
def test_a_head_whose_faces_have_missing_vertices_is_refused(vertex):
    faces = HEAD.faces.copy()
    faces[5, 0] = vertex
    with pytest.raises(HeadError, match=f"refers to vertex {vertex}, .* from 0 to {len(VERTICES) - 1},"):
        bind_head(VERTICES, faces)


def test_landmarks_whose_weight_fades_out_are_found():
    weights = HEAD.regions.copy()
    weights[:, HEAD.landmarks[from_ibug([4])]] *= 0.34
    findings = check_head(VERTICES, HEAD.faces, HEAD.landmarks, weights)
    assert [finding.problem for finding in findings] == ["Landmarks 4 are moved only partly by their regions."]
    assert check_head(VERTICES, HEAD.faces, HEAD.landmarks, hold_landmarks(weights, VERTICES, HEAD.landmarks)) == []


def test_joined_lips_are_found():
    upper, lower = HEAD.landmarks[from_ibug([62, 66])]
    nearest = HEAD.faces[(HEAD.faces == upper).any(axis=1)][0]
    bridge = np.array([[upper, lower, int(nearest[nearest != upper][0]), -1]])
    findings = check_head(VERTICES, np.concatenate([HEAD.faces, bridge]), HEAD.landmarks, HEAD.regions)
    assert [finding.problem for finding in findings] == ["The lips are joined, so the mouth cannot open."]


@pytest.mark.parametrize("opening", [0.5, 1.0, 2.0])
def test_lips_that_are_apart_at_rest_are_not_joined(opening):
    places = VERTICES + opening * HEAD.units[HEAD.unit_names.index("jawOpen")]
    assert check_head(places, HEAD.faces, HEAD.landmarks, HEAD.regions) == []


def bound_to(numbers: list[int], places: np.ndarray) -> np.ndarray:
    """Landmarks of the head, with those of iBUG `numbers` bound to the free vertices nearest to `places` (N, 3)."""
    landmarks = HEAD.landmarks.copy()
    for landmark, place in zip(from_ibug(numbers), places, strict=True):
        away = np.linalg.norm(VERTICES - place, axis=1)
        away[landmarks] = np.inf
        landmarks[landmark] = int(np.argmin(away))
    return landmarks


@pytest.mark.parametrize(
    ("numbers", "brow", "up"),
    [
        ([37, 38], [18, 19], 0.0),
        ([43, 44], [24, 25], 0.0),
        ([37, 38], [18, 19], 0.1),
        ([37, 38, 40, 41], [18, 19, 19, 18], 0.0),
        ([36, 37, 38, 39, 40, 41], [17, 18, 19, 21, 20, 18], 0.0),
        ([44], [24], 0.0),
    ],
)
def test_lids_bound_to_a_brow_are_found(numbers, brow, up):
    places = POINTS[from_ibug(brow)] - [0.0, up * UNIT, 0.0]
    landmarks = bound_to(numbers, places)
    findings = check_head(VERTICES, HEAD.faces, landmarks, HEAD.regions)
    assert LIDS_MISPLACED in [finding.problem for finding in findings]
    assert "open_eyes" not in [finding.step for finding in findings]


def test_lids_bound_to_lashes_or_to_each_other_or_corners_above_each_other_are_found():
    eye = from_ibug((42, 45))
    width = np.linalg.norm(np.subtract(*POINTS[eye]))
    lashes, swapped, upright = VERTICES.copy(), HEAD.landmarks.copy(), VERTICES.copy()
    lashes[HEAD.landmarks[from_ibug((43, 44))]] += width * np.array([0.0, -0.2, -0.45])
    lids = from_ibug((43, 44, 46, 47))
    swapped[lids] = swapped[lids[[3, 2, 1, 0]]]
    upright[HEAD.landmarks[eye[0]]] = POINTS[eye[1]] - [0.0, width, 0.0]
    for vertices, landmarks in ((lashes, HEAD.landmarks), (VERTICES, swapped), (upright, HEAD.landmarks)):
        findings = check_head(vertices, HEAD.faces, landmarks, HEAD.regions)
        assert findings[-1].problem == LIDS_MISPLACED


@pytest.mark.parametrize("opening", [0.0, 0.5, 2.0])
def test_shut_narrow_and_wide_eyes_are_not_misplaced_lids(opening):
    places = VERTICES.copy()
    upper, lower = HEAD.landmarks[UPPER_LIDS], HEAD.landmarks[LOWER_LIDS]
    middle, half = (places[upper] + places[lower]) / 2.0, (places[upper] - places[lower]) / 2.0
    places[upper], places[lower] = middle + opening * half, middle - opening * half
    assert check_head(places, HEAD.faces, HEAD.landmarks, HEAD.regions) == []
    assert check_head(stylised(), HEAD.faces, HEAD.landmarks, HEAD.regions) == []


@pytest.mark.thorough
@pytest.mark.skipif(not has_heads(DATA), reason="the people of ../shared/data are not here")
def test_no_person_has_misplaced_lids():
    for person in ict_people(DATA, 6):
        bound = bind_landmarks(person.vertices, person.faces)
        upright = person.vertices @ bound.rotation.T
        weights = propose_regions(upright, person.faces, bound.landmarks)
        findings = check_head(upright, person.faces, bound.landmarks, weights)
        assert LIDS_MISPLACED not in [finding.problem for finding in findings], person.title
