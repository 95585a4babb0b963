"""Distinguishing the tracked face from others that pass in front of it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.tracking.identity import PerformerIdentity, describe_face
from facemime.core.tracking.tracker import FaceTracker

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def sample() -> tuple[np.ndarray, np.ndarray]:
    """A grey frame of the sample clip, and the pose found in it."""
    grey = cv2.cvtColor(cv2.VideoCapture(str(ROOT / "assets" / "sample" / "sample.mp4")).read()[1], cv2.COLOR_BGR2GRAY)
    return grey, FaceTracker.load().locate(grey).pose


def looks(seed: int, count: int) -> list[np.ndarray]:
    """Descriptors of dissimilar people."""
    made = np.random.default_rng(seed).normal(size=(count, 400)).astype(np.float32)
    return list(made / np.linalg.norm(made, axis=1, keepdims=True))


def at(x: float) -> np.ndarray:
    return np.array([100.0, 0.0, 0.0, 0.0, x, 200.0])


def test_a_descriptor_has_unit_length_and_hardly_depends_on_exposure_size_and_position(
    sample: tuple[np.ndarray, np.ndarray],
) -> None:
    grey, pose = sample
    usual = describe_face(grey, pose)
    assert np.linalg.norm(usual) == pytest.approx(1.0, abs=1e-5)
    dark = np.clip(grey * 0.6 + 10, 0, 255).astype(np.uint8)
    assert describe_face(dark, pose) @ usual > 0.97
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    moved = np.array([pose[0] / 2, *pose[1:4], *((pose[4:6] + 0.5) / 2 - 0.5)])
    assert describe_face(half, moved) @ usual > 0.95


def test_a_descriptor_of_a_flat_image_is_finite() -> None:
    assert np.isfinite(describe_face(np.full((50, 50), 7, np.uint8), at(20.0))).all()


def test_the_first_face_is_recognised_and_a_different_one_is_not() -> None:
    identity = PerformerIdentity()
    one, two = looks(0, 2)
    assert identity.recognises(one)
    assert identity.recognises(one)
    assert not identity.recognises(two)


def test_nobody_is_a_bystander_before_one_was_seen() -> None:
    identity = PerformerIdentity()
    one, two = looks(1, 2)
    identity.recognises(one)
    assert not identity.is_bystander(two)
    identity.update_bystander(two, at(100.0))
    assert identity.is_bystander(two)
    assert not identity.is_bystander(one)


def test_a_lasting_change_of_appearance_is_learnt() -> None:
    identity = PerformerIdentity()
    one, two = looks(2, 2)
    identity.recognises(one)
    for _ in range(60):
        identity.adapt(two)
    assert identity.recognises(two)


def test_bystanders_are_searched_at_once_and_less_often_later() -> None:
    identity = PerformerIdentity()
    own, odd = looks(7, 2)
    identity.recognises(own)
    searched = []
    for _ in range(24):
        searched.append(identity.search_due)
        identity.adapt((own - odd) / np.linalg.norm(own - odd))
    assert all(searched[:6])
    assert sum(searched[6:]) == 3
    identity.recognises(own)
    assert identity.search_due


def test_after_a_loss_the_performer_is_distinguished_from_the_bystander() -> None:
    identity = PerformerIdentity()
    own, other = looks(3, 2)
    identity.recognises(own)
    identity.update_bystander(other, at(300.0))
    identity.frame += 1
    assert identity.candidates([other, own], [at(297.0), at(330.0)], [True, True]) == [1]


def test_an_ambiguous_face_is_the_bystanders_where_the_bystander_just_was() -> None:
    identity = PerformerIdentity()
    own, other = looks(4, 2)
    new = (own + other) / np.linalg.norm(own + other)
    identity.recognises(own)
    identity.update_bystander(other, at(300.0))
    identity.frame += 1
    assert identity.candidates([new], [at(500.0)], [True]) == [0]
    assert identity.candidates([new], [at(303.0)], [True]) == []


def test_somebody_unknown_away_from_where_the_performer_was_lost_is_a_bystander() -> None:
    identity = PerformerIdentity()
    own, other = looks(8, 2)
    identity.recognises(own)
    assert identity.candidates([other], [at(500.0)], [False]) == []
    assert identity.crowded
    assert identity.candidates([other, own], [at(500.0), at(300.0)], [False, False]) == [1]


def test_a_face_that_looks_changed_is_the_performers_where_it_was_lost() -> None:
    identity = PerformerIdentity()
    own, changed = looks(9, 2)
    identity.recognises(own)
    assert identity.candidates([changed], [at(300.0)], [True]) == [0]


def test_it_is_crowded_only_while_a_bystander_was_seen_recently() -> None:
    identity = PerformerIdentity()
    one, two = looks(6, 2)
    identity.recognises(one)
    assert not identity.crowded
    identity.update_bystander(two, at(300.0))
    assert identity.crowded
    identity.frame += 100
    assert not identity.crowded


def test_everybody_is_forgotten_when_another_face_is_tracked() -> None:
    identity = PerformerIdentity()
    own, other = looks(5, 2)
    identity.recognises(own)
    identity.update_bystander(other, at(300.0))
    identity.reset()
    assert not identity.crowded
    assert identity.recognises(other)
