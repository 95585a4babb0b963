"""Telling the tracked face from others that pass in front of it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.crossing import cross, follow
from bench.exact import Clip
from facemime.core.tracking.identity import Identity, describe_face
from facemime.core.tracking.tracker import FaceTracker

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
needs_photos = pytest.mark.skipif(not DATA.exists(), reason="the photographs of ../shared/data are not here")


@pytest.fixture(scope="module")
def tracker() -> FaceTracker:
    return FaceTracker.load()


@pytest.fixture(scope="module")
def sample() -> tuple[np.ndarray, np.ndarray]:
    """A grey frame of the sample clip and the pose that is found in it."""
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


def test_a_descriptor_of_a_flat_picture_is_finite() -> None:
    assert np.isfinite(describe_face(np.full((50, 50), 7, np.uint8), at(20.0))).all()


def test_the_first_face_is_recognised_and_a_different_one_is_not() -> None:
    identity = Identity()
    one, two = looks(0, 2)
    assert identity.recognises(one)
    assert identity.recognises(one)
    assert not identity.recognises(two)


def test_nobody_is_a_bystander_before_one_was_seen() -> None:
    identity = Identity()
    one, two = looks(1, 2)
    identity.recognises(one)
    assert not identity.is_bystander(two)
    identity.update_bystander(two, at(100.0))
    assert identity.is_bystander(two)
    assert not identity.is_bystander(one)


def test_a_lasting_change_of_appearance_is_learnt() -> None:
    identity = Identity()
    one, two = looks(2, 2)
    identity.recognises(one)
    for _ in range(60):
        identity.adapt(two)
    assert identity.recognises(two)


def test_bystanders_are_searched_at_once_and_less_often_later() -> None:
    identity = Identity()
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


def test_after_a_loss_the_performer_is_told_from_the_bystander() -> None:
    identity = Identity()
    own, other = looks(3, 2)
    identity.recognises(own)
    identity.update_bystander(other, at(300.0))
    identity.frame += 1
    assert identity.candidates([other, own], [at(297.0), at(330.0)]) == [1]


def test_an_ambiguous_face_is_the_bystanders_where_the_bystander_just_was() -> None:
    identity = Identity()
    own, other = looks(4, 2)
    new = (own + other) / np.linalg.norm(own + other)
    identity.recognises(own)
    identity.update_bystander(other, at(300.0))
    identity.frame += 1
    assert identity.candidates([new], [at(500.0)]) == [0]
    assert identity.candidates([new], [at(303.0)]) == []


def test_it_is_crowded_only_while_a_bystander_was_seen_recently() -> None:
    identity = Identity()
    one, two = looks(6, 2)
    identity.recognises(one)
    assert not identity.crowded
    identity.update_bystander(two, at(300.0))
    assert identity.crowded
    identity.frame += 100
    assert not identity.crowded


def test_everybody_is_forgotten_when_another_face_is_tracked() -> None:
    identity = Identity()
    own, other = looks(5, 2)
    identity.recognises(own)
    identity.update_bystander(other, at(300.0))
    identity.reset()
    assert not identity.crowded
    assert identity.recognises(other)


def walking(photo_name: str, size: int = 300) -> Clip:
    """A held-out person's photo of 80 pixels between the eyes, 90 frames of it."""
    from facemime.training.tracker.sources import read_photos, split

    photo = next(p for p in split(read_photos(DATA, "london_neutral"))[1] if p.name.startswith(photo_name))
    factor = 80.0 / photo.eye_distance()
    points = (photo.landmarks + 0.5) * factor - 0.5
    move = size / 2.0 - points.mean(axis=0)
    grey = cv2.resize(photo.grey(), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    matrix = np.column_stack([np.eye(2), move])
    still = cv2.warpAffine(grey, matrix, (size, size), borderMode=cv2.BORDER_REPLICATE)
    rng = np.random.default_rng(0)
    frames = [np.clip(still + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8) for _ in range(90)]
    return Clip(photo_name, frames, np.repeat((points + move)[None], 90, axis=0), np.arange(90) / 25.0)


@needs_photos
@pytest.mark.parametrize(("behind", "before"), [("070", "031"), ("031", "105")])
def test_a_face_that_was_hidden_by_a_passer_by_is_tracked_again_and_the_passer_by_never(
    tracker: FaceTracker, behind: str, before: str
) -> None:
    run = follow(tracker, *cross(walking(behind), walking(before), speed=3.5))
    assert run.other == 0
    assert run.own > 45
    assert run.returned


@needs_photos
def test_a_face_that_passes_in_front_of_another_is_never_lost(tracker: FaceTracker) -> None:
    frames, behind, before = cross(walking("070"), walking("031"), speed=3.5)
    run = follow(tracker, frames, before, behind)
    assert run.own == len(frames)
