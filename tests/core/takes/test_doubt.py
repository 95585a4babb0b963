"""Doubtful frames are those in which the tracker was least sure, far apart, and without pins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from facemime.core.face.landmarks import EYE_LEFT, JAW
from facemime.core.takes.pin_editor import APART, doubtful_frames
from facemime.core.takes.pins import Pin, with_pins
from facemime.core.takes.take import Take
from facemime.core.takes.timing import mark_lost
from tests.helpers.takes import performance


def sure(count: int = 100, certainty: float = 0.8) -> Take:
    """A take of 25 frames per second whose landmarks are all equally certain."""
    take = performance(count)
    even = np.full_like(take.landmark_confidence, certainty)
    return replace(take, landmark_confidence=even, confidence=np.full_like(take.confidence, 0.99))


def unsure(take: Take, **doubts: tuple[slice | np.ndarray, float]) -> Take:
    """Reduce the certainty of landmarks in frames named f0, f1, ..."""
    for name, (part, certainty) in doubts.items():
        take.landmark_confidence[int(name[1:]), part] = certainty
    return take


def test_the_least_certain_part_counts_and_the_most_doubtful_frame_comes_first():
    take = unsure(sure(), f20=(EYE_LEFT, 0.5), f60=(JAW, 0.3))
    assert doubtful_frames(take).tolist() == [60, 20]


def test_a_part_is_compared_with_its_own_usual_certainty():
    take = sure()
    take.landmark_confidence[:, JAW] = 0.1
    assert doubtful_frames(unsure(take, f40=(EYE_LEFT, 0.7))).tolist() == [40]


def test_frames_lie_apart():
    take = sure()
    take.landmark_confidence[:] = np.random.default_rng(0).uniform(0.2, 0.8, (len(take), 1))
    frames = doubtful_frames(take)
    assert len(frames) > 3
    assert np.diff(np.sort(take.times[frames])).min() >= APART - 1e-9


def test_a_face_that_may_be_none_is_doubtful():
    take = sure()
    take.confidence[33] = 0.4
    assert doubtful_frames(take).tolist() == [33]


def test_a_failed_fit_comes_first():
    take = unsure(sure(), f20=(EYE_LEFT, 0.05))
    take.shape[70] += np.float32(0.5)
    assert doubtful_frames(take).tolist() == [70, 20]


def test_frames_near_a_pin_and_without_a_face_are_left_out():
    take = unsure(sure(), f20=(EYE_LEFT, 0.5), f60=(JAW, 0.3), f90=(JAW, 0.4))
    pinned = with_pins(mark_lost(take, np.arange(len(take)) == 90), [Pin(float(take.times[62]), 0, 1.0, 1.0)])
    assert doubtful_frames(pinned).tolist() == [20]


def test_nothing_is_doubtful_where_no_certainty_is_known_or_no_face_is_seen():
    take = sure()
    take.landmark_confidence[:] = np.nan
    assert len(doubtful_frames(take)) == 0
    lost = with_pins(mark_lost(take, np.ones(len(take), bool)), [Pin(0.0, 0, 1.0, 1.0)])
    assert len(doubtful_frames(lost)) == 0
    assert len(doubtful_frames(sure(1))) == 0
