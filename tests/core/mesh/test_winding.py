"""Faces that were left the wrong way round are found, on pieces that lie apart and within each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.heads.bind import bind_landmarks
from facemime.core.heads.rig import built_in_head, skin_of
from facemime.core.mesh.surface import surface_normals
from facemime.core.mesh.winding import inside_out, turned_over

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""A cube whose faces all face outwards."""


def mixed(faces: np.ndarray, seed: int, share: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Faces of which some are turned over, and which."""
    chosen = np.random.default_rng(seed).random(len(faces)) < share
    return turned_over(faces, faces, chosen), chosen


def test_a_face_that_is_turned_over_has_the_opposite_normal_and_the_same_first_corner():
    faces = np.array([[0, 1, 3, 2], [0, 1, 3, -1]])
    turned = turned_over(faces, faces, np.array([True, True]))
    np.testing.assert_array_equal(turned, [[0, 2, 3, 1], [0, 3, 1, -1]])
    colours = np.arange(8.0).reshape(2, 4)
    np.testing.assert_array_equal(turned_over(colours, faces, np.array([False, True])), [[0, 1, 2, 3], [4, 6, 5, 7]])


@given(st.integers(0, 10_000), st.floats(0.0, 1.0))
def test_faces_of_a_closed_piece_that_were_turned_over_are_found(seed, share):
    faces, chosen = mixed(CUBE, seed, share)
    np.testing.assert_array_equal(inside_out(CORNERS, faces), chosen)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_a_head_whose_faces_were_turned_over_is_the_same_again(share):
    rig = built_in_head()
    faces, chosen = mixed(rig.faces, 1, share)
    np.testing.assert_array_equal(inside_out(rig.vertices, rig.faces), False)
    found = inside_out(rig.vertices, faces)
    again = turned_over(faces, faces, found)
    normals = surface_normals(rig.vertices, rig.faces)
    np.testing.assert_allclose(surface_normals(rig.vertices, again), normals, atol=1e-9)
    np.testing.assert_array_equal(found, chosen)


def test_a_hollow_whose_faces_agree_keeps_facing_inwards():
    inner = 0.25 + 0.5 * CORNERS
    hollow = turned_over(CUBE, CUBE, np.ones(6, bool)) + 8
    outer, chosen = mixed(CUBE, 3)
    found = inside_out(np.concatenate([CORNERS, inner]), np.concatenate([outer, hollow]))
    np.testing.assert_array_equal(found, [*chosen, *[False] * 6])


def test_a_surface_without_an_outside_and_edges_of_three_faces_are_left_alone():
    strip = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5], [4, 5, 1], [1, 5, 0]])  # a Moebius strip
    places = np.random.default_rng(0).normal(size=(6, 3))
    assert inside_out(places, strip).shape == (6,)
    fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert len(np.unique(inside_out(places, fan))) == 1
    assert inside_out(places, np.empty((0, 3), int)).shape == (0,)


def test_a_face_is_found_on_a_mesh_with_mixed_normals():
    rig = built_in_head()
    plain = bind_landmarks(rig.vertices.astype(float), rig.faces)
    faces, _ = mixed(rig.faces, 2)
    skin = skin_of(rig.vertices, faces)
    found = bind_landmarks(rig.vertices[skin.kept].astype(float), skin.faces)
    np.testing.assert_array_equal(skin.kept[found.landmarks], plain.landmarks)
