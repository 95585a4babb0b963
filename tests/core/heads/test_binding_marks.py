"""Marks, which refine what is found without them, or lead the search for a face that is not found otherwise."""

import numpy as np
import pytest

from facemime.core.errors import HeadError
from facemime.core.face.landmarks import (
    BROWS,
    EYE_CORNERS,
    EYE_LEFT,
    EYE_RIGHT,
    JAW,
    LIPS,
    MIRROR,
    NOSE,
    from_ibug,
    outer_eye_distance,
)
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.files.assets import ASSETS
from facemime.core.heads.bind import MARKS, bind_landmarks
from facemime.core.heads.facegen import read_tri
from facemime.core.heads.landmark_vertices import pull
from tests.helpers.built_in import HEAD, POINTS, UNIT, VERTICES, stylised
from tests.helpers.scans import scanned
from tests.helpers.thorough import first_of

EYES = (36, 39, 42, 45)
LIDS = np.concatenate([EYE_RIGHT, EYE_LEFT])


def jane() -> tuple[np.ndarray, np.ndarray]:
    mesh = read_tri(ASSETS / "facegen" / "Jane.tri")
    return mesh.vertices.astype(float), mesh.faces


def squat() -> np.ndarray:
    """The head with a lower face that is half as high, which is bound in doubt."""
    places = VERTICES * [1.15, 1.0, 1.0]
    places[:, 1] -= 0.5 * np.maximum(places[:, 1] - POINTS[from_ibug([33])[0], 1], 0.0)
    return places


def split() -> tuple[np.ndarray, np.ndarray]:
    """The head, stylised, split along its middle as at the seam of a texture."""
    right = (VERTICES[HEAD.faces[:, 0]][:, None, 0] + VERTICES[HEAD.faces[:, 2]][:, None, 0] < 0.0)[:, 0]
    faces = HEAD.faces.copy()
    faces[right] = np.where(faces[right] >= 0, faces[right] + len(VERTICES), -1)
    used, numbers = np.unique(faces[faces >= 0], return_inverse=True)
    faces[faces >= 0] = numbers
    return np.concatenate([stylised(), stylised()])[used], faces


def marked(landmarks: np.ndarray, numbers: tuple[int, ...] = EYES) -> dict[int, int]:
    return {number: int(landmarks[from_ibug([number])[0]]) for number in numbers}


def nearest(places: np.ndarray, place: np.ndarray) -> int:
    return int(np.linalg.norm(places - place, axis=1).argmin())


@pytest.mark.parametrize("numbers", first_of([EYES, (30, 48, 54, 8), tuple(MARKS)]), ids=["eyes", "below", "all"])
@pytest.mark.parametrize(
    "mesh", first_of([(squat(), HEAD.faces), (VERTICES, HEAD.faces), (stylised(), HEAD.faces), scanned(), jane()])
)
def test_marks_where_landmarks_were_found_without_any_change_nothing(mesh, numbers):
    found = bind_landmarks(*mesh)
    again = bind_landmarks(*mesh, marked(found.landmarks, numbers))
    np.testing.assert_array_equal(again.landmarks, found.landmarks)
    assert set(again.wanted) == set(found.wanted) - set(numbers)


def test_corners_of_the_eyes_move_lids_and_nothing_else():
    places, faces = stylised(), HEAD.faces
    before = bind_landmarks(places, faces).landmarks
    wanted = places[before[EYE_CORNERS]] + 0.08 * UNIT * np.array([[-1, 0, 0], [1, 0, 0], [-1, 0, 0], [1, 0, 0]])
    marks = {number: nearest(places, place) for number, place in zip(EYES, wanted, strict=True)}
    after = bind_landmarks(places, faces, marks).landmarks
    np.testing.assert_array_equal(after[EYE_CORNERS], list(marks.values()))
    others = np.setdiff1d(np.arange(66), LIDS)
    np.testing.assert_array_equal(after[others], before[others])
    for lids in (EYE_RIGHT, EYE_LEFT):
        x = np.abs(places[after[lids], 0] - places[after[lids[0]], 0])
        assert (x[[1, 5]] < x[[2, 4]]).all() and (x[[1, 2, 4, 5]] < x[3]).all()


def test_a_chin_takes_the_jaw_line_along_and_leaves_the_mouth():
    places, before = VERTICES, bind_landmarks(VERTICES, HEAD.faces).landmarks
    up = nearest(places, POINTS[8] - [0.0, 0.1 * UNIT, 0.0])
    after = bind_landmarks(places, HEAD.faces, {**marked(before), 8: up}).landmarks
    moved = (places[before] - places[after])[:, 1] / UNIT
    assert after[8] == up and moved[8] > 0.06
    assert moved[[7, 9]].min() > 0.5 * moved[8] and np.abs(moved[[0, 1, 15, 16]]).max() < 0.25 * moved[8]
    np.testing.assert_array_equal(
        after[np.concatenate([LIPS, NOSE, BROWS])], before[np.concatenate([LIPS, NOSE, BROWS])]
    )


def test_a_mark_on_one_side_of_a_symmetric_head_moves_the_other_side_alike():
    before = bind_landmarks(VERTICES, HEAD.faces).landmarks
    down = nearest(VERTICES, POINTS[from_ibug([48])[0]] + [-0.05 * UNIT, 0.1 * UNIT, 0.0])
    marks = {**marked(before, (36, 30, 8)), 48: down}
    points = VERTICES[bind_landmarks(VERTICES, HEAD.faces, marks).landmarks]
    right, left = points[from_ibug([48, 54])]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=2e-3 * UNIT)
    assert abs(points[from_ibug([48])[0]] - POINTS[from_ibug([48])[0]])[1] > 0.05 * UNIT


def test_landmarks_follow_marks_across_the_seam_of_a_texture():
    places, faces = split()
    before = bind_landmarks(places, faces).landmarks
    corners = from_ibug([48, 54])
    aside = [nearest(places, places[before[corner]] + [0.12 * UNIT, 0.0, 0.0]) for corner in corners]
    marks = {**marked(before, (36, 45)), **dict(zip((48, 54), aside, strict=True))}
    after = bind_landmarks(places, faces, marks).landmarks
    sides = LIPS[MIRROR[LIPS] != LIPS]
    moved = (places[after] - places[before])[sides, 0] / UNIT
    crossed = (places[before[sides], 0] < 0.0) & (places[after[sides], 0] > 0.0)
    assert len(set(after.tolist())) == 66 and moved.min() > 0.05 and crossed.any()


def test_marks_settle_the_doubt_about_their_own_landmarks_only():
    binding = bind_landmarks(squat(), HEAD.faces)
    assert len(binding.wanted) == 4
    few = tuple(number for number in MARKS if number not in binding.wanted)
    again = bind_landmarks(squat(), HEAD.faces, marked(HEAD.landmarks, few))
    assert again.wanted == binding.wanted and "mark four points" in again.doubt
    part = bind_landmarks(squat(), HEAD.faces, marked(HEAD.landmarks, (*few[:3], binding.wanted[0])))
    assert part.wanted == binding.wanted[1:] and str(part.doubt).endswith(str(MARKS[part.wanted[-1]]))
    assert bind_landmarks(squat(), HEAD.faces, marked(HEAD.landmarks, binding.wanted)).sure


@pytest.mark.thorough
def test_the_corners_of_the_eyes_alone_lead_to_a_head_that_is_not_found_without():
    """They nearly lie on one line, about which the head may be rotated."""
    turn = euler_to_matrix(0.9, 0.7, 0.5)
    with pytest.raises(HeadError, match="No face was found"):
        bind_landmarks(VERTICES @ turn.T, HEAD.faces)
    binding = bind_landmarks(VERTICES @ turn.T, HEAD.faces, marked(HEAD.landmarks))
    away = np.linalg.norm(VERTICES[binding.landmarks] - POINTS, axis=1)
    assert away.mean() < 0.02 * UNIT and np.abs(binding.rotation @ turn - np.eye(3)).max() < 0.1


def test_marks_on_another_face_than_the_one_that_is_found_lead_to_theirs():
    places = np.concatenate([VERTICES, VERTICES + [4.0 * UNIT, 0.0, 0.0]])
    faces = np.concatenate([HEAD.faces, np.where(HEAD.faces < 0, -1, HEAD.faces + len(VERTICES))])
    for start in (0, len(VERTICES)):
        found = bind_landmarks(places, faces, {n: v + start for n, v in marked(HEAD.landmarks, tuple(MARKS)).items()})
        off = np.linalg.norm(places[found.landmarks] - places[HEAD.landmarks + start], axis=1)
        assert off.mean() < 0.02 * UNIT


def test_what_a_mark_pulls_fades_with_distance_and_is_nothing_without_a_move():
    assert not pull(POINTS, {int(i): POINTS[i] for i in EYE_CORNERS}).any()
    down = np.array([0.0, 0.2 * UNIT, 0.0])
    pulled = pull(POINTS, {int(NOSE[3]): POINTS[NOSE[3]] + down, 8: POINTS[8] - down})
    assert np.allclose(pulled[NOSE[3]], down) and (np.diff(pulled[NOSE[:4], 1]) > 0.0).all()
    assert np.allclose(pulled[8], -down) and (np.diff(np.abs(pulled[JAW[:9], 1])) > 0.0).all()
    assert not pulled[np.concatenate([LIDS, LIPS, BROWS])].any()
    assert np.abs(pulled).max() <= 0.2 * UNIT and outer_eye_distance(POINTS) == pytest.approx(UNIT)
