"""Landmarks of brows that are pieces of their own are bound below them."""

import numpy as np
import pytest

from facemime.core.face.landmarks import BROWS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.brows import place_on_brows
from facemime.core.heads.part_names import names_brow
from tests.helpers.built_in import HEAD, POINTS, UNIT, VERTICES


def brow_pieces(up: float = 0.0, before: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Two strips along the brows of the head, raised and in front of the skin, in outer-eye distances."""
    line = POINTS[BROWS] - [0.0, up * UNIT, before * UNIT]
    edge = np.array([0.0, 0.03 * UNIT, 0.0])
    rows = [i for i in range(9) if i != 4]
    return np.concatenate([line - edge, line + edge]), np.array([[i, i + 1, i + 11, i + 10] for i in rows])


def lowered(down: float) -> np.ndarray:
    """The landmarks of the head, with those of the brows on free vertices that lie lower, in outer-eye distances."""
    landmarks = HEAD.landmarks.copy()
    for landmark in BROWS:
        away = np.linalg.norm(VERTICES - POINTS[landmark] - [0.0, down * UNIT, 0.0], axis=1)
        away[landmarks] = np.inf
        landmarks[landmark] = int(np.argmin(away))
    return landmarks


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.1, -0.15, 0.05)])
def test_landmarks_beside_a_brow_move_to_the_skin_below_it(angles):
    turn = euler_to_matrix(*angles)
    brows, faces = brow_pieces()
    before = lowered(0.12)
    found = place_on_brows(VERTICES @ turn.T, HEAD.faces, before, brows @ turn.T, faces)
    off = [np.linalg.norm(VERTICES[marks[BROWS]] - POINTS[BROWS], axis=1).mean() / UNIT for marks in (before, found)]
    assert off[0] > 0.09 and off[1] < 0.045
    assert len(set(found.tolist())) == 66
    np.testing.assert_array_equal(np.delete(found, BROWS), np.delete(before, BROWS))


def test_landmarks_on_a_brow_stay():
    brows, faces = brow_pieces()
    np.testing.assert_array_equal(place_on_brows(VERTICES, HEAD.faces, HEAD.landmarks, brows, faces), HEAD.landmarks)


@pytest.mark.parametrize(("up", "before"), [(-0.4, 0.02), (0.0, 0.4)])
def test_a_brow_below_its_eye_or_far_from_the_skin_is_ignored(up, before):
    brows, faces = brow_pieces(up, before)
    landmarks = lowered(0.12)
    np.testing.assert_array_equal(place_on_brows(VERTICES, HEAD.faces, landmarks, brows, faces), landmarks)


def test_a_brow_of_one_side_moves_the_landmarks_of_that_side():
    brows, faces = brow_pieces()
    landmarks = lowered(0.12)
    found = place_on_brows(VERTICES, HEAD.faces, landmarks, brows, faces[:4])
    assert (found != landmarks)[BROWS[:5]].any()
    np.testing.assert_array_equal(found[BROWS[5:]], landmarks[BROWS[5:]])


@pytest.mark.parametrize(
    ("name", "brow"),
    [
        ("N00_000_00_FaceBrow_00_FACE (Instance)", True),
        ("Eyebrows", True),
        ("eyebrow001", True),
        ("まゆ.眉毛", True),
        ("Eyelash_Eyebrow", False),
        ("Brown_Hair", False),
        ("FaceEyeline", False),
    ],
)
def test_the_name_of_a_piece_tells_whether_it_is_the_brows(name, brow):
    assert names_brow(name) == brow
