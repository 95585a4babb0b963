"""Lids of few vertices slide over an eyeball without their edges cutting through it."""

import numpy as np
import pytest

from facemime.core.heads.eyeballs import EyeballContact

BALL = np.array([[0.3, -0.2, 0.5, 0.02]])


def lid(columns: int, low: float) -> tuple[np.ndarray, np.ndarray]:
    """A strip of skin around the front of the eyeball, from an angle above its middle upwards, and its faces."""
    across, up = np.meshgrid(np.radians(np.linspace(-70.0, 70.0, columns)), np.radians([low, low + 30.0, low + 60.0]))
    towards = np.stack([np.sin(across) * np.cos(up), -np.sin(up), -np.cos(across) * np.cos(up)], axis=-1)
    places = (BALL[0, :3] + 1.01 * BALL[0, 3] * towards.reshape(-1, 3)).astype(np.float32)
    first = (np.arange(2)[:, None] * columns + np.arange(columns - 1)).ravel()
    return places, np.column_stack([first, first + 1, first + 1 + columns, first + columns])


def depths(places: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance of the middles of edges and faces from the centre, in radii."""
    ends = np.concatenate([faces[:, [k, (k + 1) % 4]] for k in range(4)])
    middles = np.concatenate([places[ends].mean(axis=1), places[faces].mean(axis=1)])
    return np.linalg.norm(middles - BALL[0, :3], axis=1) / BALL[0, 3]


@pytest.mark.parametrize("columns", [3, 4, 5])
def test_the_edges_of_coarse_lids_hardly_cut_through_an_eye_that_shuts(columns):
    rest, faces = lid(columns, 15.0)
    contact = EyeballContact(rest, np.ones(len(rest)), BALL, faces)
    shut = rest + np.float32([0.0, 0.6 * BALL[0, 3], 0.0])
    contact.resolve(shut)
    without = rest + np.float32([0.0, 0.6 * BALL[0, 3], 0.0])
    EyeballContact(rest, np.ones(len(rest)), BALL).resolve(without)
    cut = [1.0 - depths(places, faces).min() for places in (shut, without)]
    assert cut[0] < 0.1 and cut[0] < 0.7 * cut[1]
    assert np.linalg.norm(shut - BALL[0, :3], axis=1).max() < 1.5 * BALL[0, 3]


def test_coarse_lids_at_rest_stay_where_they_are():
    rest, faces = lid(5, 15.0)
    still = rest.copy()
    EyeballContact(rest, np.ones(len(rest)), BALL, faces).resolve(still)
    np.testing.assert_array_equal(still, rest)


def test_fine_lids_move_as_without_their_faces():
    rest, faces = lid(41, 15.0)
    rest, faces = rest[:41], faces[:0]
    shut = rest + np.float32([0.0, 0.4 * BALL[0, 3], 0.0])
    other = shut.copy()
    EyeballContact(rest, np.ones(len(rest)), BALL, faces).resolve(shut)
    EyeballContact(rest, np.ones(len(rest)), BALL).resolve(other)
    np.testing.assert_array_equal(shut, other)
