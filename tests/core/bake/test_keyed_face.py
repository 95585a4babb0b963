"""Faces are located by the motion of shape keys."""

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.bake.key_quality import face_from_keys
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.built_in import load_head

HEAD = load_head()
SIGNS = list(product((1.0, -1.0), repeat=3))
TURNS = [np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in SIGNS]
TURNS = [turn for turn in TURNS if np.linalg.det(turn) > 0]


@pytest.mark.thorough
@given(
    st.sampled_from(TURNS),
    st.floats(0.01, 100.0),
    st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3),
    st.sampled_from(["arkit", "vrm", "facegen"]),
)
def test_the_built_in_head_is_found_anywhere_at_any_size_turned_by_right_angles(turn, size, place, name):
    mixtures = KEY_SETS[name].mixtures
    moved = np.einsum("ku,uvc->kvc", mixtures, HEAD.units) * size @ turn.T
    vertices = HEAD.vertices.astype(np.float64) * size @ turn.T + np.array(place) * size
    face = face_from_keys(vertices, mixtures, list(moved))
    np.testing.assert_array_equal(face.upright, turn.T)
    off = np.linalg.norm(vertices[face.landmarks] - vertices[HEAD.landmarks], axis=1)
    assert np.median(off) < 1e-3 * size * outer_eye_distance(HEAD.vertices[HEAD.landmarks])
    assert len(np.unique(face.landmarks)) == 66


def test_two_keys_or_only_looks_are_too_few():
    eye = np.eye(len(COEFFICIENTS))
    with pytest.raises(HeadError, match="Too few"):
        face_from_keys(HEAD.vertices, eye[:2], list(HEAD.units[:2]))
    looks = [i for i, name in enumerate(COEFFICIENTS) if name.startswith("eyeLook")]
    with pytest.raises(HeadError, match="Too few"):
        face_from_keys(HEAD.vertices, eye[looks], list(HEAD.units[looks]))
