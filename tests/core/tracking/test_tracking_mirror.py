"""A mirrored result equals that of the mirrored image."""

from pathlib import Path

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import facemime
from facemime.core.face.landmarks import MIRROR, N_LANDMARKS, OUTER_EYE_CORNERS
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.result import TrackResult, mirror_result

CLIP = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"
FIELDS = ("landmarks", "pose", "shape_params", "shape", "landmark_confidence", "pupils", "gaze")


def any_result(pdm: PointDistributionModel, seed: int) -> TrackResult:
    """A face within the model and the views of a tracker, with the left eye shut."""
    rng = np.random.default_rng(seed)
    params = rng.normal(size=pdm.n_modes) * np.sqrt(pdm.eigenvalues)
    pose = np.array([150.0, *rng.uniform(-0.6, 0.6, 3), *rng.uniform(100, 400, 2)])
    return TrackResult(
        True,
        pdm.project(pose, params),
        pose,
        params,
        pdm.shape(params),
        0.8,
        rng.random(N_LANDMARKS),
        np.array([rng.uniform(0, 400, 2), [np.nan, np.nan]]),
        rng.normal(size=2),
    )


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.floats(16, 4096))
def test_mirroring_twice_restores_the_result(tracker, seed, width):
    result = any_result(tracker.pdm, seed)
    signs = tracker.pdm.mirror_signs
    twice = mirror_result(mirror_result(result, width, signs), width, signs)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(twice, name), getattr(result, name), atol=1e-9)
    assert (twice.found, twice.confidence) == (True, 0.8)


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_mirrored_pose_and_parameters_still_explain_the_mirrored_landmarks(tracker, seed):
    mirrored = mirror_result(any_result(tracker.pdm, seed), 640, tracker.pdm.mirror_signs)
    np.testing.assert_allclose(tracker.pdm.shape(mirrored.shape_params), mirrored.shape, atol=1e-9)
    np.testing.assert_allclose(tracker.pdm.project(mirrored.pose, mirrored.shape_params), mirrored.landmarks, atol=1e-8)


def test_mirroring_swaps_the_sides(tracker):
    result = any_result(tracker.pdm, 3)
    mirrored = mirror_result(result, 640)
    right, left = result.eye_apertures
    np.testing.assert_allclose(mirrored.eye_apertures, [left, right])
    assert np.isnan(mirrored.pupils[0]).all()
    np.testing.assert_allclose(mirrored.pupils[1], [639 - result.pupils[0, 0], result.pupils[0, 1]])
    np.testing.assert_array_equal(mirrored.landmark_confidence, result.landmark_confidence[MIRROR])
    np.testing.assert_array_equal(mirrored.gaze, result.gaze * [1, -1])


def test_without_the_models_signs_the_parameters_are_unknown(tracker):
    assert np.isnan(mirror_result(any_result(tracker.pdm, 0), 640).shape_params).all()
    basis = np.random.default_rng(0).normal(size=(N_LANDMARKS, 3, 2))
    lopsided = PointDistributionModel(tracker.pdm.mean_shape, basis, np.ones(2))
    assert np.isnan(lopsided.mirror_signs).all()
    assert np.isin(tracker.pdm.mirror_signs, (-1.0, 1.0)).all()


def test_a_lost_face_stays_lost():
    assert not mirror_result(TrackResult.nothing(5), 640).found
    assert np.isnan(mirror_result(TrackResult.nothing(5), 640).landmarks).all()


def test_tracking_a_mirrored_image_gives_the_mirrored_result(tracker):
    image = cv2.VideoCapture(str(CLIP)).read()[1]
    flipped = tracker.locate(np.ascontiguousarray(image[:, ::-1]))
    mirrored = mirror_result(tracker.locate(image), image.shape[1], tracker.pdm.mirror_signs)
    unit = np.linalg.norm(np.subtract(*mirrored.landmarks[OUTER_EYE_CORNERS]))
    away = np.linalg.norm(flipped.landmarks - mirrored.landmarks, axis=1) / unit
    assert np.median(away) < 0.02
    np.testing.assert_allclose(flipped.pose[1:4], mirrored.pose[1:4], atol=0.06)
