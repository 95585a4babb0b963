"""Measures of the tracking benchmark, on landmarks with known errors."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.face.landmarks import LOWER_LIDS, UPPER_LIDS
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.accuracy import aperture_errors, count_blinks, delay, differences, eye_distances, jitter
from lab.bench.tracking import paces


@pytest.fixture(scope="module")
def face() -> np.ndarray:
    """(66, 2) pixels, 100 between the outer eye corners."""
    return 100.0 * FaceTracker.load().pdm.mean_shape[:, :2] + (320.0, 240.0)


def test_a_constant_offset_is_an_error_that_offsets_remove(face):
    truth = np.stack([face, 3.0 * face])
    found = truth + np.array([2.0, 6.0])[:, None, None] * (1.0, 0.0)
    away = differences(found, truth, eye_distances(truth))
    np.testing.assert_allclose(away.errors(), 2.0, rtol=1e-3)
    np.testing.assert_allclose(away.errors(away.offsets()), 0.0, atol=1e-9)


def test_offsets_rotate_with_the_head(face):
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    truth = np.stack([face, face @ turn.T])
    found = np.stack([face + (0.0, 3.0), (face + (0.0, 3.0)) @ turn.T])
    away = differences(found, truth, 100.0)
    np.testing.assert_allclose(away.values[0], away.values[1], atol=1e-9)


def test_lost_faces_do_not_affect_the_offsets(face):
    truth = np.stack([face] * 3)
    found = truth + 1.0
    found[1] = np.nan
    away = differences(found, truth, 100.0)
    assert np.isinf(away.errors()[1])
    np.testing.assert_allclose(away.errors(away.offsets())[[0, 2]], 0.0, atol=1e-9)


def test_constant_landmarks_have_no_jitter_and_noise_has_its_own(face):
    still = np.stack([face] * 40)
    assert jitter([still], 100.0).position == 0.0
    noisy = still + np.random.default_rng(0).normal(0, 0.5, still.shape)
    assert jitter([noisy], 100.0).position == pytest.approx(0.5 * np.sqrt(2.0), rel=0.1)
    assert jitter([noisy], 200.0).position == pytest.approx(0.25 * np.sqrt(2.0), rel=0.1)


def blinking(face: np.ndarray, spans: list[tuple[int, int]], length: int = 80) -> np.ndarray:
    clip = np.stack([face] * length)
    for start, end in spans:
        clip[start:end, UPPER_LIDS] = clip[start:end, LOWER_LIDS]
    return clip


def test_blinks_are_counted_as_detected_missed_or_false(face):
    truth = blinking(face, [(10, 13), (30, 34), (50, 53)])
    found = blinking(face, [(11, 14), (31, 33), (70, 73)])
    count = count_blinks(found, truth)
    assert (count.true, count.found, count.reported, count.correct) == (3, 2, 3, 2)
    assert count.recall == pytest.approx(2 / 3) and (count + count).precision == pytest.approx(2 / 3)


def test_lids_that_follow_by_half_have_half_the_slope(face):
    truth, found = np.stack([face] * 10), np.stack([face] * 10)
    closing = np.linspace(0.0, 6.0, 10)[:, None]
    truth[:, UPPER_LIDS, 1] += closing
    found[:, UPPER_LIDS, 1] += 0.5 * closing
    assert aperture_errors(found, truth, 100.0).eye_slope == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize("late", [0.0, 0.6, 2.0])
def test_a_delay_is_measured_to_a_twentieth_of_a_frame(late):
    times = np.arange(100.0)
    assert delay(np.sin(0.2 * times), np.sin(0.2 * (times - late))) == pytest.approx(late, abs=0.05)


def test_compared_trackers_take_turns_at_every_frame():
    shown: list[tuple[str, int]] = []

    class Watcher:
        def __init__(self, name: str) -> None:
            self.name = name

        def track(self, image: np.ndarray) -> None:
            shown.append((self.name, int(image[0])))

        def reset(self) -> None:
            pass

    timed = paces([Watcher("a"), Watcher("b")], [np.array([k]) for k in range(8)])
    assert [k for _, k in shown] == [k for k in range(8) for _ in "ab"]
    assert {shown[i][0] for i in range(0, 16, 2)} == {"a", "b"}, "none is always first"
    assert all({shown[i][0], shown[i + 1][0]} == {"a", "b"} for i in range(0, 16, 2)) and set(timed) == {"a", "b"}
