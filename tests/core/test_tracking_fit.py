"""The mean-shift fit on response maps whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.tracking.fit import MeanShiftOptions, mean_shifts, regularised_mean_shift
from facemime.core.tracking.patch_experts import ResponseMaps
from facemime.core.tracking.pdm import FittedShape, PointDistributionModel
from facemime.core.tracking.tracker import FaceTracker

OPTIONS = MeanShiftOptions((16.0, 8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0), 0.1)


@pytest.fixture(scope="module")
def pdm() -> PointDistributionModel:
    return FaceTracker.load().pdm


def peaks_at(landmarks: np.ndarray, centres: np.ndarray, radius: int) -> ResponseMaps:
    """Response maps with one Gaussian peak at each landmark."""
    corner = np.round(centres).astype(int) - radius
    steps = np.arange(2 * radius + 1)
    x, y = corner[:, :1] + steps - landmarks[:, :1], corner[:, 1:] + steps - landmarks[:, 1:]
    probability = np.exp(-0.5 * (x[:, None, :] ** 2 + y[:, :, None] ** 2))
    return ResponseMaps(probability.astype(np.float32), corner)


def displaced_face(pdm: PointDistributionModel, seed: int) -> tuple[np.ndarray, FittedShape]:
    """True landmarks, and a start that is somewhat beside them."""
    rng = np.random.default_rng(seed)
    pose = np.array([70.0, *rng.normal(0, 0.2, 2), 0.0, 100.0, 100.0])
    shape_params = rng.normal(0, 0.6, pdm.n_modes) * np.sqrt(pdm.eigenvalues)
    start = pose + np.array([2.0, 0.05, -0.05, 0.03, 3.0, -3.0])
    return pdm.project(pose, shape_params), FittedShape(start, 0.5 * shape_params)


@pytest.mark.parametrize("seed", range(6))
def test_a_face_is_recovered_from_peaks_at_its_landmarks(pdm: PointDistributionModel, seed: int) -> None:
    truth, start = displaced_face(pdm, seed)
    maps = peaks_at(truth, pdm.project(start.pose, start.shape_params), 12)
    fitted = regularised_mean_shift(pdm, start, maps, np.ones(66), OPTIONS)
    away = np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - truth, axis=1)
    assert away.mean() < 0.5
    assert np.linalg.norm(pdm.project(start.pose, start.shape_params) - truth, axis=1).mean() > 3.0


def test_hidden_landmarks_are_carried_by_the_visible_ones(pdm: PointDistributionModel) -> None:
    truth, start = displaced_face(pdm, 1)
    hidden = np.arange(48, 56)
    lies = truth.copy()
    lies[hidden] += 7.0
    weights = np.ones(66)
    weights[hidden] = 0.0
    maps = peaks_at(lies, pdm.project(start.pose, start.shape_params), 14)
    fitted = regularised_mean_shift(pdm, start, maps, weights, OPTIONS)
    away = np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - truth, axis=1)
    assert away[hidden].mean() < 2.5


def test_the_separable_mean_shift_is_the_weighted_mean_of_the_paper() -> None:
    rng = np.random.default_rng(0)
    maps = ResponseMaps(rng.random((5, 9, 9)).astype(np.float32), rng.integers(0, 30, (5, 2)))
    landmarks = maps.corner + rng.uniform(2, 6, (5, 2))
    shift = mean_shifts(maps, landmarks, 2.5)
    for i in range(5):
        y, x = np.mgrid[0:9, 0:9]
        places = np.stack([x, y], -1) + maps.corner[i]
        near = np.exp(-((places - landmarks[i]) ** 2).sum(-1) / 5.0) * maps.probability[i]
        mean = (near[..., None] * places).sum((0, 1)) / near.sum()
        np.testing.assert_allclose(shift[:, i], mean - landmarks[i], atol=1e-4)


def test_a_landmark_far_outside_its_window_is_drawn_nowhere() -> None:
    maps = ResponseMaps(np.ones((1, 9, 9), np.float32), np.zeros((1, 2), int))
    shift = mean_shifts(maps, np.array([[500.0, 500.0]]), 1.0)
    np.testing.assert_allclose(shift, 0.0)


def test_without_evidence_the_shape_returns_to_the_mean(pdm: PointDistributionModel) -> None:
    _, start = displaced_face(pdm, 2)
    maps = ResponseMaps(np.zeros((66, 9, 9), np.float32), np.zeros((66, 2), int))
    fitted = regularised_mean_shift(pdm, start, maps, np.ones(66), MeanShiftOptions((4.0,) * 3, 1e6))
    assert np.abs(fitted.shape_params).max() < 0.05 * np.abs(start.shape_params).max()
