"""The skin of a mesh: its pieces, seams that are closed, and slits that stay open."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import LIPS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import HeadRig, built_in_head, skin_of
from facemime.core.mesh.surface import border_twins, islands
from facemime.core.takes.neutral import calibrate
from tests.helpers.takes import performance


def split_at(vertices: np.ndarray, faces: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split a mesh between faces (F,) with and without `side`; also return the original of each vertex."""
    shared = np.intersect1d(faces[side & (faces >= 0).all(axis=1)], faces[~side & (faces >= 0).all(axis=1)])
    copies = np.arange(len(vertices))
    copies[shared] = len(vertices) + np.arange(len(shared))
    parted = np.where(side[:, None] & (faces >= 0), copies[faces], faces)
    return np.concatenate([vertices, vertices[shared]]), parted, np.append(np.arange(len(vertices)), shared)


def split_rig() -> tuple[HeadRig, np.ndarray]:
    """The built-in head with texture seams down the middle and across, and the original of each vertex."""
    rig = built_in_head()
    middle = rig.vertices[rig.faces[:, :3]].mean(axis=1)
    vertices, faces, first = split_at(rig.vertices, rig.faces, middle[:, 0] + 0.3 * middle[:, 1] > 0.0)
    return replace(rig, vertices=vertices, faces=faces, region_weights=rig.region_weights[:, first]), first


def test_a_mesh_is_divided_into_the_pieces_it_was_made_of():
    one = np.array([[0, 1, 2, -1], [1, 2, 3, -1]])
    faces = np.concatenate([one, np.array([[4, 5, 6, 7]]), one[:0]])
    np.testing.assert_array_equal(islands(9, faces), [0, 0, 0, 0, 1, 1, 1, 1, 2])


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(0, 40)), min_size=1, max_size=40))
def test_vertices_are_in_one_piece_if_and_only_if_a_chain_of_faces_joins_them(triangles):
    number = islands(41, np.array(triangles))
    label = list(range(41))
    for _ in range(41):
        for face in triangles:
            low = min(label[v] for v in face)
            for v in face:
                label[v] = low
    same = np.equal.outer(label, label)
    np.testing.assert_array_equal(np.equal.outer(number, number), same)


def test_a_seam_of_the_texture_is_closed_and_the_skin_moves_as_without_it():
    take = performance()
    neutral = calibrate(take)
    rig, first = split_rig()
    assert len(rig.vertices) > len(built_in_head().vertices) + 20
    skin = skin_of(rig.vertices, rig.faces, None, rig.landmarks)
    assert len(skin.kept) == len(built_in_head().vertices)
    whole, split = HeadDriver(built_in_head(), neutral), HeadDriver(rig, neutral)
    unit = rig.eye_distance
    for index in np.flatnonzero(take.found)[::20]:
        result = take.result(index)
        off = split.frame(result).vertices - whole.frame(result).vertices[first]
        assert np.abs(off).max() < 1e-4 * unit


def slit_face() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A flat face with lips that were cut apart: vertices, faces, landmarks, and the vertices (2, N) of either lip."""
    head = load_head()
    points = head.vertices[head.landmarks][:, :2] / built_in_head().eye_distance
    across, down = np.arange(-1.0, 1.0, 0.02), np.arange(-0.6, 1.6, 0.02)
    grid = np.stack([*np.meshgrid(across, down), np.zeros((len(down), len(across)))], axis=-1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(len(down), len(across))
    faces = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    landmarks = np.array([np.linalg.norm(grid[:, :2] - point, axis=1).argmin() for point in points])
    row = grid[landmarks[LIPS], 1].mean().round(2)
    slit = np.flatnonzero((np.abs(grid[:, 1] - row) < 0.011) & (np.abs(grid[:, 0]) < 0.2))
    slit = slit[grid[slit, 1] == grid[slit, 1].min()]
    copies = np.arange(len(grid))
    copies[slit] = len(grid) + np.arange(len(slit))
    below = grid[faces, 1].mean(axis=1) > grid[slit[0], 1]
    cut = np.where(below[:, None], copies[faces], faces)
    return np.concatenate([grid, grid[slit]]), cut, landmarks, np.stack([slit, copies[slit]])


def test_lips_that_were_cut_apart_without_a_gap_stay_apart():
    vertices, faces, landmarks, lips = slit_face()
    assert len(skin_of(vertices, faces).kept) == len(vertices) - lips.shape[1]
    assert len(skin_of(vertices, faces, None, landmarks).kept) == len(vertices)


def test_the_inside_of_a_mouth_is_joined_to_the_lips_across_a_seam_of_the_texture():
    vertices, faces, landmarks, lips = slit_face()
    vertices[lips[1], 1] += 1e-3  # lips that nearly touch
    inside = len(vertices) + np.arange(lips.size).reshape(lips.shape)
    wall = np.stack([inside[0, :-1], inside[0, 1:], inside[1, 1:], inside[1, :-1]], axis=-1)
    vertices = np.concatenate([vertices, vertices[lips.ravel()]])
    skin = skin_of(vertices, np.concatenate([faces, wall]), None, landmarks)
    np.testing.assert_array_equal(skin.number[inside], skin.number[lips])
    assert (skin.number[lips[0]] != skin.number[lips[1]]).all()


def test_layers_that_touch_inside_a_mesh_are_not_joined():
    rig = built_in_head()
    doubled = np.concatenate([rig.vertices, rig.vertices])
    faces = np.concatenate([rig.faces, np.where(rig.faces >= 0, rig.faces + len(rig.vertices), -1)])
    inside = np.setdiff1d(
        np.arange(len(doubled)), np.flatnonzero(border_twins(doubled, faces) != np.arange(len(doubled)))
    )
    assert len(inside) > 0.9 * len(doubled)
