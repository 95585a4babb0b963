"""Tracking of a face while another one passes in front of it, in photos of two held-out people."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.tracking.tracker import FaceTracker
from lab.bench.crossing import cross, follow
from lab.bench.exact import Clip
from lab.training.tracker.sources import read_photos, split

DATA = Path(__file__).parents[3] / "shared" / "data"
needs_photos = pytest.mark.skipif(not DATA.exists(), reason="the photographs of ../shared/data are not here")


@pytest.fixture(scope="module")
def tracker() -> FaceTracker:
    return FaceTracker.load()


def walking(photo_name: str, size: int = 300) -> Clip:
    """A clip that repeats a held-out person's photo for 90 frames, with 80 pixels between the eyes."""
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


@pytest.mark.thorough
@needs_photos
@pytest.mark.parametrize(("behind", "before"), [("070", "031"), ("031", "105")])
def test_a_face_hidden_by_a_passer_by_is_tracked_again_and_the_passer_by_never(
    tracker: FaceTracker, behind: str, before: str
) -> None:
    run = follow(tracker, *cross(walking(behind), walking(before), speed=3.5))
    assert run.other == 0
    assert run.own > 45
    assert run.returned


@pytest.mark.thorough
@needs_photos
def test_a_face_that_passes_in_front_of_another_is_never_lost(tracker: FaceTracker) -> None:
    frames, behind, before = cross(walking("070"), walking("031"), speed=3.5)
    run = follow(tracker, frames, before, behind)
    assert run.own == len(frames)
