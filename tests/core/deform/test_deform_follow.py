"""Landmarks that are not control points."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.control_points.greedy import greedy_select
from facemime.core.control_points.selection import from_json, to_json
from facemime.core.deform.covariance import follow_matrix, landmark_covariance
from facemime.core.deform.head_deformer import head_deformer
from facemime.core.errors import SourceError
from facemime.core.face.landmarks import from_ibug
from facemime.core.heads.built_in import load_head
from facemime.core.heads.regions import DEFAULT_KERNEL, REGIONS, membership, region_sigmas
from facemime.core.heads.rig import built_in_head
from facemime.core.mesh.kernels import get_kernel

HEAD = load_head()
POINTS = HEAD.vertices[HEAD.landmarks].astype(float)
UNITS = HEAD.units[:, HEAD.landmarks].astype(float)
SEEN, UNSEEN = UNITS[::2], UNITS[1::2]
KERNEL = get_kernel(DEFAULT_KERNEL)
SIGMAS = region_sigmas(POINTS, KERNEL)


def some(seed: int, count: int) -> np.ndarray:
    """Choose `count` random landmarks as control points, with at least one per region."""
    rng = np.random.default_rng(seed)
    known = np.zeros(66, dtype=bool)
    known[rng.choice(66, count, replace=False)] = True
    known[[rng.choice(region.landmarks) for region in REGIONS]] = True
    return membership() & known


def matrix(members: np.ndarray, covariance: np.ndarray | None) -> np.ndarray:
    return follow_matrix(POINTS, members, covariance, KERNEL, SIGMAS)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.integers(0, 60), st.booleans())
def test_control_points_are_met_and_other_landmarks_are_ignored(seed, count, learnt):
    members = some(seed, count)
    known = members.any(axis=0)
    found = matrix(members, landmark_covariance(SEEN) if learnt else None)
    np.testing.assert_array_equal(found[known][:, known], np.eye(known.sum()))
    assert not found[:, ~known].any() and np.isfinite(found).all()


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(1e-6, 1e6))
def test_the_scale_of_the_motion_does_not_matter(seed, factor):
    members, covariance = some(seed, 20), landmark_covariance(SEEN)
    np.testing.assert_allclose(matrix(members, factor * covariance), matrix(members, covariance), atol=1e-7)


def test_all_landmarks_as_control_points_follow_themselves():
    np.testing.assert_array_equal(matrix(membership(), landmark_covariance(SEEN)), np.eye(66))


def test_a_landmark_follows_an_opposed_one_as_in_the_take():
    one, other = from_ibug([20, 23])
    motion = np.zeros((40, 66, 3))
    motion[:, one] = np.random.default_rng(0).normal(size=(40, 3))
    motion[:, other] = -motion[:, one]
    members = membership()
    members[:, other] = False
    assert matrix(members, None)[other, one] > -0.2
    assert matrix(members, landmark_covariance(motion))[other, one] < -0.5


def test_without_motion_distance_alone_decides():
    members = some(3, 20)
    np.testing.assert_array_equal(matrix(members, np.zeros((66, 66))), matrix(members, None))


def test_other_expressions_improve_too():
    chosen = greedy_select(POINTS, SEEN, tolerance=1e-4, max_points=33)
    off = []
    for covariance in (chosen.covariance, None):
        found = np.einsum("qp,npk->nqk", matrix(chosen.membership, covariance), UNSEEN)
        off.append(np.linalg.norm(found - UNSEEN, axis=2).sum())
    assert off[0] < 0.97 * off[1]


@pytest.mark.thorough
@pytest.mark.parametrize("kernel", ["gaussian", "informed"])
def test_the_covariance_of_the_take_lowers_the_skin_error(kernel):
    rig = built_in_head()
    chosen = greedy_select(POINTS, SEEN, tolerance=1e-4, max_points=33)
    half = replace(rig, control_points=chosen.membership)
    rigs = (rig, half, replace(half, covariance=chosen.covariance))
    every, alone, learnt = (
        np.stack([driver.deform(d) for d in UNITS]) for driver in (head_deformer(r, kernel) for r in rigs)
    )
    assert np.linalg.norm(learnt - every) < 0.9 * np.linalg.norm(alone - every)


def test_the_covariance_survives_the_file_and_older_files_have_none():
    chosen = greedy_select(POINTS, SEEN, max_points=20)
    again = from_json(to_json(chosen))
    np.testing.assert_allclose(again.covariance, chosen.covariance, rtol=1e-4, atol=1e-15)
    np.testing.assert_array_equal(again.covariance, again.covariance.T)
    assert from_json(to_json(replace(chosen, covariance=None))).covariance is None


@pytest.mark.parametrize("damage", [[1.0, 2.0], [float("nan")] * 2211, "none"])
def test_an_invalid_covariance_is_refused(damage):
    text = json.loads(to_json(greedy_select(POINTS, SEEN, max_points=20))) | {"covariance": damage}
    with pytest.raises(SourceError, match="not a control point file"):
        from_json(json.dumps(text))
