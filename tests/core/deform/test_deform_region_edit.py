"""Mirroring and smoothing of regions."""

import numpy as np
import pytest

from facemime.core.face.landmarks import MIRROR, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, from_ibug
from facemime.core.heads.built_in import load_head
from facemime.core.heads.regions import mirror_regions, smooth_regions

HEAD = load_head()
BROW_RIGHT, BROW_LEFT = from_ibug((19, 24))


@pytest.mark.parametrize(
    ("source", "kept", "overwritten"), [("right", BROW_RIGHT, BROW_LEFT), ("left", BROW_LEFT, BROW_RIGHT)]
)
def test_paint_on_one_half_appears_on_the_other(source, kept, overwritten):
    weights = np.array(HEAD.regions)
    weights[2, HEAD.landmarks[kept]], weights[2, HEAD.landmarks[overwritten]] = 0.7, 0.2
    mirrored = mirror_regions(HEAD.vertices, HEAD.faces, HEAD.landmarks, weights, source)
    assert mirrored[2, HEAD.landmarks[kept]] == mirrored[2, HEAD.landmarks[overwritten]] == np.float32(0.7)


def test_a_mirrored_head_that_is_turned_and_scaled_is_symmetric_at_its_landmarks_and_again_the_same():
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    vertices = 30.0 * HEAD.vertices @ turn.T + 5.0
    left = HEAD.vertices[:, 0] > 0.0
    weights = np.where(left, HEAD.regions, 0.0)
    once = mirror_regions(vertices, HEAD.faces, HEAD.landmarks, weights, "left")
    pairs = [i for i in range(66) if MIRROR[i] != i]
    at = once[:, HEAD.landmarks]
    np.testing.assert_allclose(at[:, pairs], at[:, MIRROR[pairs]], atol=0.05)
    assert at[:, [i for i in pairs if i >= 36]].max(axis=0).min() >= 0.5
    np.testing.assert_array_equal(mirror_regions(vertices, HEAD.faces, HEAD.landmarks, once, "left"), once)


def test_smoothing_keeps_weights_in_bounds_and_lips_apart_while_borders_get_softer():
    weights = (HEAD.regions > 0.5).astype(np.float32)
    smooth = smooth_regions(HEAD.vertices, HEAD.faces, weights, 3)
    assert smooth.min() >= 0.0 and smooth.sum(axis=0).max() <= weights.sum(axis=0).max() + 1e-6
    assert ((smooth > 0.05) & (smooth < 0.95)).sum() > ((weights > 0.05) & (weights < 0.95)).sum()
    upper, lower = HEAD.landmarks[MOUTH_INNER_UPPER[1]], HEAD.landmarks[MOUTH_INNER_LOWER[1]]
    assert smooth[1, upper] > 0.9 and smooth[2, upper] < 0.1
    assert smooth[2, lower] > 0.9 and smooth[1, lower] < 0.1


def test_a_loose_vertex_keeps_its_weight():
    vertices = np.vstack([HEAD.vertices, [[9.0, 9.0, 9.0]]])
    weights = np.pad(HEAD.regions, ((0, 0), (0, 1)), constant_values=0.3)
    assert smooth_regions(vertices, HEAD.faces, weights, 2)[0, -1] == np.float32(0.3)
