"""The point distribution model: its derivatives, its signs, and what it recovers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.base.landmarks import from_ibug
from facemime.core.base.rotation import euler_to_matrix
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.tracker import FaceTracker


@pytest.fixture(scope="module")
def pdm() -> PointDistributionModel:
    return FaceTracker.load().pdm


def random_state(pdm: PointDistributionModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    pose = np.array([rng.uniform(30, 200), *rng.uniform(-0.6, 0.6, 3), *rng.uniform(0, 500, 2)])
    return pose, rng.normal(0, 1, pdm.n_modes) * np.sqrt(pdm.eigenvalues)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_the_jacobian_is_the_limit_of_differences(pdm: PointDistributionModel, seed: int) -> None:
    pose, shape_params = random_state(pdm, seed)
    jacobian = pdm.jacobian(pose, shape_params)
    state, step = np.concatenate([pose, shape_params]), 1e-6
    for k in range(len(state)):
        up, down = state.copy(), state.copy()
        up[k], down[k] = state[k] + step, state[k] - step
        difference = (pdm.project(up[:6], up[6:]) - pdm.project(down[:6], down[6:])) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, k], difference.T, atol=1e-4)


def test_the_mean_has_unit_distance_between_its_outer_eye_corners(pdm: PointDistributionModel) -> None:
    right, left = pdm.mean_shape[from_ibug([36, 45])]
    assert np.linalg.norm(right - left) == pytest.approx(1.0, abs=1e-4)
    assert right[0] < 0 < left[0]


def test_angles_have_the_documented_signs(pdm: PointDistributionModel) -> None:
    tip = pdm.mean_shape[from_ibug([30])[0]]
    assert tip[2] < 0
    nose = np.array([0.0, 0.0, -1.0])
    assert (euler_to_matrix(0.3, 0, 0) @ nose)[1] > 0
    assert (euler_to_matrix(0, 0.3, 0) @ nose)[0] < 0
    right = np.array([1.0, 0.0, 0.0])
    assert (euler_to_matrix(0, 0, 0.3) @ right)[1] > 0


def test_a_face_without_rotation_is_projected_by_dropping_depth(pdm: PointDistributionModel) -> None:
    points = pdm.project(np.array([50.0, 0, 0, 0, 7.0, 9.0]), np.zeros(pdm.n_modes))
    np.testing.assert_allclose(points, 50.0 * pdm.mean_shape[:, :2] + (7.0, 9.0))


@pytest.mark.parametrize("seed", range(8))
def test_fitting_a_projected_face_recovers_its_landmarks_and_pose(pdm: PointDistributionModel, seed: int) -> None:
    pose, shape_params = random_state(pdm, seed)
    landmarks = pdm.project(pose, shape_params)
    fitted = pdm.fit(landmarks, noise=0.002, iterations=40)
    away = np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - landmarks, axis=1).mean()
    assert away < 0.005 * pose[0]
    np.testing.assert_allclose(fitted.pose[1:4], pose[1:4], atol=0.12)


def test_landmarks_of_weight_zero_are_ignored(pdm: PointDistributionModel) -> None:
    pose, shape_params = random_state(pdm, 3)
    landmarks = pdm.project(pose, shape_params)
    weights = np.ones(66)
    weights[:10] = 0.0
    wild = landmarks.copy()
    wild[:10] += 1000.0
    a, b = pdm.fit(landmarks, weights), pdm.fit(wild, weights)
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-6)


def test_a_step_keeps_coefficients_within_five_deviations_and_the_scale_positive(pdm: PointDistributionModel) -> None:
    pose, shape_params = random_state(pdm, 5)
    delta = np.full(6 + pdm.n_modes, 1e3)
    delta[0] = -1e6
    moved = pdm.step(pose, shape_params, delta)
    assert moved.pose[0] > 0
    assert (np.abs(moved.pose[1:4]) <= np.pi).all()
    assert (np.abs(moved.shape_params) <= 5.0 * np.sqrt(pdm.eigenvalues) + 1e-9).all()


def test_a_head_turn_alone_leaves_the_fitted_expression_alone(pdm: PointDistributionModel) -> None:
    _, shape_params = random_state(pdm, 11)
    shapes = []
    for yaw in (-0.5, 0.0, 0.5):
        landmarks = pdm.project(np.array([100.0, 0.1, yaw, 0.0, 200.0, 200.0]), 0.5 * shape_params)
        shapes.append(pdm.shape(pdm.fit(landmarks, noise=0.002, iterations=40).shape_params))
    for shape in (shapes[0], shapes[2]):
        assert np.abs(shape[:, :2] - shapes[1][:, :2])[17:].mean() < 0.012
