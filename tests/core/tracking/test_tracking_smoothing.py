"""Live smoothing holds rest still, lets fast motion pass, and smooths nothing across losses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.face.landmarks import LOWER_LIDS, LOWER_LIPS, N_LANDMARKS, UPPER_LIDS, UPPER_LIPS
from facemime.core.face.names import N_COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.takes.smooth import smooth_take
from facemime.core.takes.take import FIELDS
from facemime.core.takes.timing import mark_lost
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.smoothing import SHAPE_PARTS, Cutoffs, OneEuroFilter, ResultSmoother
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.takes import performance

FPS = 25.0


@pytest.fixture(scope="module")
def face() -> np.ndarray:
    return FaceTracker.load().pdm.mean_shape


def result_of(shape: np.ndarray, pose: np.ndarray | None = None, gaze: tuple[float, float] = (0.0, 0.0)) -> TrackResult:
    pose = np.array([150.0, 0.0, 0.0, 0.0, 320.0, 240.0]) if pose is None else pose
    landmarks = pose[0] * shape @ euler_to_matrix(*pose[1:4])[:2].T + pose[4:6]
    return TrackResult(True, landmarks, pose, np.zeros(3), shape, 0.9, gaze=np.array(gaze))


def smoothed(results: list[TrackResult]) -> list[TrackResult]:
    smoother = ResultSmoother()
    return [smoother.smooth(result, i / FPS) for i, result in enumerate(results)]


def closing(face: np.ndarray, upper: np.ndarray, lower: np.ndarray, share: float) -> np.ndarray:
    """The face with two rims brought closer by `share` of their distance."""
    shape = face.copy()
    middle = 0.5 * (face[upper] + face[lower])
    for rim in (upper, lower):
        shape[rim] += share * (middle - face[rim])
    return shape


def test_every_landmark_belongs_to_one_part() -> None:
    rows = np.concatenate([rows for rows, _ in SHAPE_PARTS.values()])
    assert sorted(rows.tolist()) == list(range(N_LANDMARKS))


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.floats(0.1, 5.0), st.floats(0.0, 100.0), st.floats(0.001, 0.3))
def test_a_filter_stays_within_the_range_of_its_input(seed, at_rest, by_speed, step):
    seen = np.random.default_rng(seed).normal(size=(30, 4))
    run = OneEuroFilter(Cutoffs(at_rest, by_speed, 2.0))
    out = np.array([run(row, i * step) for i, row in enumerate(seen)])
    assert (out <= np.maximum.accumulate(seen) + 1e-12).all() and (out >= np.minimum.accumulate(seen) - 1e-12).all()


@settings(max_examples=40)
@given(st.floats(-1e3, 1e3), st.floats(0.1, 5.0))
def test_a_constant_passes_unchanged(value, at_rest):
    run = OneEuroFilter(Cutoffs(at_rest, 10.0, 2.0))
    for i in range(10):
        np.testing.assert_allclose(run(np.array([value]), i / FPS), value)


def test_a_repeated_time_changes_nothing() -> None:
    run = OneEuroFilter(Cutoffs(1.0, 0.0, 1.0))
    run(np.zeros(2), 0.0)
    before = run(np.ones(2), 0.04)
    np.testing.assert_array_equal(run(np.full(2, 9.0), 0.04), before)


def test_noise_on_a_resting_face_is_more_than_halved(face):
    rng = np.random.default_rng(0)
    noisy = [result_of(face + rng.normal(0, 0.001, face.shape)) for _ in range(100)]
    out = np.stack([r.landmarks for r in smoothed(noisy)])[20:]
    raw = np.stack([r.landmarks for r in noisy])[20:]
    assert out.std(axis=0).mean() < 0.5 * raw.std(axis=0).mean()


@pytest.mark.parametrize(
    ("upper", "lower", "aperture"),
    [(UPPER_LIDS, LOWER_LIDS, "eye_apertures"), (UPPER_LIPS, LOWER_LIPS, "mouth_aperture")],
    ids=["blink", "lips"],
)
def test_a_three_frame_closure_is_kept_within_a_tenth_and_without_delay(face, upper, lower, aperture):
    share = np.zeros(40)
    share[18:25] = (0.3, 0.8, 1.0, 1.0, 1.0, 0.7, 0.3)
    results = [result_of(closing(face, upper, lower, s)) for s in share]
    raw, out = (np.array([np.mean(getattr(r, aperture)) for r in run]) for run in (results, smoothed(results)))
    rest = raw[0]
    assert out[20:23].min() < 0.05 * rest
    assert out[20] < 0.15 * rest
    assert np.abs(out - raw).max() < 0.2 * rest


def test_a_blink_leaves_brows_and_mouth_alone(face):
    results = [result_of(closing(face, UPPER_LIDS, LOWER_LIDS, float(10 <= i < 14))) for i in range(20)]
    for out in smoothed(results):
        for part in ("brows", "mouth", "jaw", "nose"):
            np.testing.assert_allclose(out.shape[SHAPE_PARTS[part][0]], face[SHAPE_PARTS[part][0]])


def test_landmarks_are_the_smoothed_shape_at_the_smoothed_pose(face):
    rng = np.random.default_rng(1)
    results = [
        result_of(face + rng.normal(0, 0.01, face.shape), np.array([150, 0.1, 0.2, 0.1, 300 + 4 * i, 240.0]))
        for i in range(12)
    ]
    for out in smoothed(results):
        expected = out.pose[0] * out.shape @ euler_to_matrix(*out.pose[1:4])[:2].T + out.pose[4:6]
        np.testing.assert_allclose(out.landmarks, expected)
        assert out.confidence == 0.9


def test_after_a_loss_the_next_face_passes_unchanged(face):
    nothing = TrackResult.nothing(3)
    far = result_of(face + 0.1, np.array([80.0, 0.2, 0.4, 0.0, 100.0, 50.0]))
    run = smoothed([result_of(face)] * 5 + [nothing, far])
    assert not run[5].found
    np.testing.assert_allclose(run[6].landmarks, far.landmarks)
    np.testing.assert_array_equal(run[6].shape, far.shape)


def test_an_unknown_gaze_stays_unknown_and_the_next_one_passes(face):
    looking, shut = result_of(face, gaze=(0.0, 0.3)), replace(result_of(face), gaze=np.full(2, np.nan))
    run = smoothed([result_of(face), shut, looking])
    assert np.isnan(run[1].gaze).all()
    np.testing.assert_array_equal(run[2].gaze, looking.gaze)


@pytest.mark.parametrize("amount", [0.3, 1.0, 4.0])
def test_a_take_is_smoothed_as_its_frames_are_live(amount):
    rng, take = np.random.default_rng(5), performance()
    lost, unknown = rng.random(len(take)) < 0.1, rng.random(len(take)) < 0.2
    take = mark_lost(replace(take, times=take.times + rng.uniform(0.0, 0.01, len(take))), lost)
    take.pose[take.found] += rng.normal(scale=0.02, size=(take.found.sum(), 6))
    take.gaze[unknown], take.actions[unknown, 3] = np.nan, np.nan
    take.coefficients[take.found] = rng.random((take.found.sum(), N_COEFFICIENTS))
    smoother, whole = ResultSmoother(amount), smooth_take(take, amount)
    for frame, time in enumerate(take.times):
        live, of_take = smoother.smooth(take.result(frame), time), whole.result(frame)
        for name in FIELDS[1:]:
            np.testing.assert_allclose(getattr(of_take, name), getattr(live, name), rtol=1e-6, atol=1e-6, err_msg=name)


def test_a_take_is_smoothed_once_and_keeps_its_losses():
    take = performance()
    smooth = smooth_take(take)
    assert smooth.info["smoothed"] and smooth_take(smooth) is smooth
    np.testing.assert_array_equal(smooth.found, take.found)
    np.testing.assert_array_equal(smooth.times, take.times)
    assert np.isfinite(smooth.shape[smooth.found]).all()
    away = np.abs(smooth.shape - take.shape)[take.found]
    assert 0.0 < away.max() < 0.05
