"""The mean-shift fit on response maps with known landmarks."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.face.landmarks import N_LANDMARKS
from facemime.core.tracking.experts import ResponseMaps
from facemime.core.tracking.mean_shift import Evidence, MeanShiftOptions, regularised_mean_shift
from facemime.core.tracking.pdm import FittedShape, PointDistributionModel
from facemime.core.tracking.tracker import FaceTracker

OPTIONS = MeanShiftOptions((np.inf, 16.0, 4.0, 1.0, 1.0), 0.1)


@pytest.fixture(scope="module")
def pdm() -> PointDistributionModel:
    return FaceTracker.load().pdm


def peaks_at(landmarks: np.ndarray, centres: np.ndarray, radius: int) -> ResponseMaps:
    """Response maps with one Gaussian peak at each landmark."""
    corner = np.round(centres) - radius
    steps = np.arange(2 * radius + 1)
    x, y = corner[:, :1] + steps - landmarks[:, :1], corner[:, 1:] + steps - landmarks[:, 1:]
    likely = np.exp(-0.5 * (x[:, None, :] ** 2 + y[:, :, None] ** 2)) + 1e-9
    likely /= likely.sum((1, 2), keepdims=True)
    stride = np.ones((N_LANDMARKS, 1), np.float32)
    return ResponseMaps(np.arange(N_LANDMARKS), likely.astype(np.float32), corner.astype(np.float32), stride)


def displaced_face(pdm: PointDistributionModel, seed: int) -> tuple[np.ndarray, FittedShape]:
    """True landmarks, and a start that is slightly off."""
    rng = np.random.default_rng(seed)
    pose = np.array([70.0, *rng.normal(0, 0.2, 2), 0.0, 100.0, 100.0])
    shape_params = rng.normal(0, 0.6, pdm.n_modes) * np.sqrt(pdm.eigenvalues)
    start = pose + np.array([2.0, 0.05, -0.05, 0.03, 3.0, -3.0])
    return pdm.project(pose, shape_params), FittedShape(start, 0.5 * shape_params)


@pytest.mark.parametrize("seed", range(6))
def test_a_face_is_recovered_from_peaks_at_its_landmarks(pdm: PointDistributionModel, seed: int) -> None:
    truth, fitted = displaced_face(pdm, seed)
    assert np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - truth, axis=1).mean() > 3.0
    maps = peaks_at(truth, pdm.project(fitted.pose, fitted.shape_params), 12)
    for _ in range(2):
        fitted = regularised_mean_shift(pdm, fitted, [Evidence(maps, np.ones(66))], OPTIONS)
    away = np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - truth, axis=1)
    assert away.mean() < 0.5


def test_hidden_landmarks_follow_the_visible_ones(pdm: PointDistributionModel) -> None:
    truth, start = displaced_face(pdm, 1)
    hidden = np.arange(48, 56)
    lies = truth.copy()
    lies[hidden] += 7.0
    weights = np.ones(66)
    weights[hidden] = 0.0
    maps = peaks_at(lies, pdm.project(start.pose, start.shape_params), 14)
    fitted = regularised_mean_shift(pdm, start, [Evidence(maps, weights)], OPTIONS)
    away = np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - truth, axis=1)
    assert away[hidden].mean() < 2.5


def test_evidence_counts_by_its_weight(pdm: PointDistributionModel) -> None:
    truth, start = displaced_face(pdm, 3)
    centres = pdm.project(start.pose, start.shape_params)
    here, there = peaks_at(truth, centres, 14), peaks_at(truth + (4.0, 0.0), centres, 14)
    options = MeanShiftOptions((np.inf,) * 6, 1e-3)
    both = [Evidence(here, np.full(66, 3.0)), Evidence(there, np.ones(66), coarse=True)]
    fitted = regularised_mean_shift(pdm, start, both, options)
    away = pdm.project(fitted.pose, fitted.shape_params) - truth
    assert away[:, 0].mean() == pytest.approx(1.0, abs=0.15)


def test_without_evidence_the_shape_returns_to_the_mean(pdm: PointDistributionModel) -> None:
    truth, start = displaced_face(pdm, 2)
    maps = peaks_at(truth, truth, 5)
    fitted = regularised_mean_shift(pdm, start, [Evidence(maps, np.zeros(66))], MeanShiftOptions((4.0,) * 3, 1e6))
    assert np.abs(fitted.shape_params).max() < 0.05 * np.abs(start.shape_params).max()


def test_without_evidence_a_held_fit_stays_where_it_starts(pdm: PointDistributionModel) -> None:
    truth, start = displaced_face(pdm, 2)
    options = MeanShiftOptions((4.0,) * 3, 1e-3, held=np.array([1.0, 0.05, 0.05, 0.02, 1.0, 1.0]))
    fitted = regularised_mean_shift(pdm, start, [Evidence(peaks_at(truth, truth, 5), np.zeros(66))], options)
    np.testing.assert_allclose(fitted.pose, start.pose, atol=1e-9)
    np.testing.assert_allclose(fitted.shape_params, start.shape_params, atol=1e-9)


@pytest.mark.parametrize("free", [0.1, 1.0, 10.0])
def test_the_pose_moves_the_farther_the_less_it_is_held(pdm: PointDistributionModel, free: float) -> None:
    truth, start = displaced_face(pdm, 5)
    maps = [Evidence(peaks_at(truth, pdm.project(start.pose, start.shape_params), 14), np.ones(66))]

    def moved(factor: float) -> float:
        held = factor * np.array([1.0, 0.05, 0.05, 0.02, 1.0, 1.0])
        fitted = regularised_mean_shift(pdm, start, maps, MeanShiftOptions((np.inf,) * 4, 1.0, held=held))
        return float(np.abs(fitted.pose - start.pose)[4:6].max())

    assert moved(0.3 * free) < moved(free)


@pytest.mark.parametrize("seed", range(4))
def test_occluded_landmarks_are_down_weighted_and_follow_the_others(pdm: PointDistributionModel, seed: int) -> None:
    truth, start = displaced_face(pdm, seed)
    covered = np.r_[3:8, 48:52]
    lies = truth.copy()
    lies[covered] += (8.0, -6.0)
    maps = peaks_at(lies, pdm.project(start.pose, start.shape_params), 16)

    def away(outlier_scale: float) -> float:
        fitted = start
        for _ in range(2):
            options = MeanShiftOptions((np.inf,) * 8, 1.0, outlier_scale)
            fitted = regularised_mean_shift(pdm, fitted, [Evidence(maps, np.ones(66))], options)
        return float(np.linalg.norm(pdm.project(fitted.pose, fitted.shape_params) - truth, axis=1).mean())

    assert away(2.0) < 0.3 * away(np.inf)


def test_the_outlier_scale_has_no_effect_if_all_maps_agree(pdm: PointDistributionModel) -> None:
    truth, start = displaced_face(pdm, 4)
    maps = peaks_at(truth, pdm.project(start.pose, start.shape_params), 14)
    one, other = (
        regularised_mean_shift(
            pdm, start, [Evidence(maps, np.ones(66))], MeanShiftOptions((np.inf,) * 8, 0.01, outlier_scale)
        )
        for outlier_scale in (2.0, np.inf)
    )
    assert np.abs(pdm.project(one.pose, one.shape_params) - pdm.project(other.pose, other.shape_params)).max() < 0.3
