"""The covariance of the skin, and its solver."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.deform.covariance import skin_covariance
from facemime.core.deform.head_deformer import head_deformer
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import MIRROR, MOUTH_INNER_LOWER, MOUTH_INNER_UPPER
from facemime.core.heads.rig import built_in_head
from facemime.core.numeric.linalg import SymmetricSystem

RIG = built_in_head()
LANDMARKS = np.asarray(RIG.vertices, float)[RIG.landmarks]
COVARIANCE = skin_covariance(RIG.vertices, RIG.faces, RIG.landmarks, RIG.region_weights)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([1, 2, 60, 400]))
def test_the_sparse_solver_agrees_with_a_dense_solver(seed, count):
    rng = np.random.default_rng(seed)
    pairs = np.sort(rng.integers(0, count, (3 * count, 2)), axis=1)
    edges = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    weights = -rng.uniform(0.1, 1.0, len(edges))
    diagonal = 0.1 - np.bincount(edges.ravel(), np.repeat(weights, 2), count)
    dense = np.diag(diagonal)
    dense[edges[:, 0], edges[:, 1]] = dense[edges[:, 1], edges[:, 0]] = weights
    right = rng.normal(size=(count, 4))
    found = SymmetricSystem(edges, weights, diagonal).solve(right)
    np.testing.assert_allclose(found, np.linalg.solve(dense, right), atol=1e-9)


def test_lapack_is_never_asked_for_the_inverse_of_nothing(capfd):
    count = 400
    solver = SymmetricSystem(np.empty((0, 2), int), np.empty(0), np.full(count, 2.0))
    np.testing.assert_allclose(solver.solve(np.ones((count, 1))), 0.5)
    assert capfd.readouterr() == ("", ""), "some LAPACKs end the process after a message"


def test_the_covariance_is_positive_definite_symmetric_and_one_on_average():
    among = COVARIANCE.control_points
    np.testing.assert_allclose(among, among.T, atol=1e-9)
    assert np.linalg.eigvalsh(among).min() > 0.0
    assert abs(np.diag(among).mean() - 1.0) < 1e-9
    np.testing.assert_allclose(among[np.ix_(MIRROR, MIRROR)], among, atol=0.02)


def test_lips_that_touch_are_far_apart_along_the_skin():
    upper, lower = MOUTH_INNER_UPPER[1], MOUTH_INNER_LOWER[1]
    beside = MOUTH_INNER_UPPER[0]
    apart, along = (np.linalg.norm(LANDMARKS[upper] - LANDMARKS[other]) for other in (lower, beside))
    assert apart < along
    assert COVARIANCE.control_points[upper, lower] < 0.5 * COVARIANCE.control_points[upper, beside]


def test_vertices_outside_regions_or_without_landmarks_have_no_covariance():
    still = ~RIG.region_weights.any(axis=0)
    assert not COVARIANCE.vertices[still].any()
    loose = np.vstack([RIG.vertices, np.asarray(RIG.vertices)[:3] + 0.01])
    weights = np.pad(RIG.region_weights, ((0, 0), (0, 3)), constant_values=0.5)
    faces = np.vstack([RIG.faces, [[1781, 1782, 1783, -1]]])
    covariance = skin_covariance(loose, faces, RIG.landmarks, weights)
    assert not covariance.vertices[-3:].any()
    rig = replace(RIG, vertices=loose, faces=faces, region_weights=weights)
    moved = head_deformer(rig).deform(np.full((66, 3), 0.01)) - loose
    shares = weights[:, -3:].sum(axis=0).clip(max=1.0)
    assert np.linalg.norm(moved[-3:], axis=1).min() > 0.5 * 0.01 * shares.min()


def test_scale_and_position_of_the_head_do_not_matter():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turned = 30.0 * np.asarray(RIG.vertices, float) @ turn.T + 5.0
    again = skin_covariance(turned, RIG.faces, RIG.landmarks, RIG.region_weights)
    np.testing.assert_allclose(again.vertices, COVARIANCE.vertices, rtol=1e-5, atol=5e-6)


def test_polygons_of_any_size_are_accepted():
    faces = np.full((len(RIG.faces), 6), -1)
    faces[:, : RIG.faces.shape[1]] = RIG.faces
    faces = np.vstack([faces, [[0, 1, 2, 3, 4, -1]]])
    assert np.isfinite(skin_covariance(RIG.vertices, faces, RIG.landmarks, RIG.region_weights).vertices).all()


def test_a_head_without_regions_is_refused_with_advice():
    rig = RIG
    with pytest.raises(HeadError, match="Paint the regions"):
        head_deformer(replace(rig, region_weights=np.zeros_like(rig.region_weights)))
