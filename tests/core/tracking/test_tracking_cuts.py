"""Faces after a cut to another scene, where the one of the scene before need not be awaited."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from facemime.core.files.assets import SAMPLE
from facemime.core.tracking.cuts import LostScene
from facemime.core.tracking.identity import LEFTMOST, FaceChoice, PerformerIdentity
from facemime.core.tracking.pdm import FittedShape
from facemime.core.tracking.tracker import FaceTracker

ROOM = np.random.default_rng(3)


def sample_frames(count):
    """The first frames of the sample."""
    video = cv2.VideoCapture(str(SAMPLE))
    return [video.read()[1] for _ in range(count)]


def closer(frame, scale, x, y):
    """The same scene, closer or farther, with what was in the middle at (x, y)."""
    height, width = frame.shape[:2]
    matrix = np.float32([[scale, 0, x - scale * width / 2], [0, scale, y - scale * height / 2]])
    return cv2.warpAffine(frame, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)


def somebody_else(frame):
    """Another face, in another room."""
    changed = cv2.warpAffine(cv2.flip(frame, 1), np.float32([[0.62, 0, -110], [0, 0.85, 90]]), frame.shape[1::-1])
    room = cv2.resize(ROOM.integers(0, 255, (5, 7, 3)).astype(np.uint8), frame.shape[1::-1])
    return np.where(changed > 0, changed, room)


@pytest.mark.parametrize(
    "scene", [lambda f: closer(f, 1.9, 250, 200), lambda f: closer(f, 0.5, 500, 300), somebody_else]
)
def test_a_lone_face_is_found_in_the_first_frame_after_a_cut(tracker: FaceTracker, scene):
    tracker.reset()
    frames = sample_frames(12)
    assert all(tracker.track(frame).found for frame in frames[:6])
    assert [tracker.track(scene(frame)).found for frame in frames[6:9]] == [True] * 3
    assert [tracker.track(frame).found for frame in frames[9:]] == [True] * 3


def test_the_face_that_was_chosen_by_its_side_is_tracked_after_a_cut_too(tracker: FaceTracker):
    frame = sample_frames(1)[0][90:390, 180:460]
    pair = np.hstack([frame, closer(frame, 0.9, 140, 150)])
    farther = np.hstack([closer(frame, 0.5, 140, 110), closer(cv2.flip(frame, 1), 1.1, 140, 170)])
    tracker.choose(*LEFTMOST)
    for picture in (pair, pair, farther, farther):
        result = tracker.track(picture)
        assert result.found and result.landmarks[:, 0].mean() < 200


def seen(images):
    """Whether each image shows another scene than the first one, which has the face."""
    scene = LostScene()
    scene.keep(images[0])
    return [scene.is_another(image) for image in images[1:]]


def test_only_a_cut_begins_another_scene():
    first, other = (cv2.resize(ROOM.integers(0, 255, (6, 8)).astype(np.uint8), (160, 120)) for _ in range(2))
    walking = [np.where(np.arange(160) < 4 * step, other, first) for step in range(41)]
    assert not any(seen(walking))
    covered = np.full_like(first, 9)
    assert not any(seen([first, covered, covered, first])[-1:])
    assert seen([first, first, other, other]) == [False, True, True]
    assert seen([first, covered, other])[-1]


def test_a_face_that_is_kept_again_starts_from_its_own_scene():
    first, other = (cv2.resize(ROOM.integers(0, 255, (6, 8)).astype(np.uint8), (160, 120)) for _ in range(2))
    scene = LostScene()
    assert not scene.is_another(first)
    scene.keep(first)
    assert scene.is_another(other)
    scene.keep(other)
    assert not scene.is_another(other) and scene.is_another(first)


def test_a_face_that_never_was_one_for_certain_is_not_awaited():
    fit = FittedShape(np.array([80.0, 0.0, 0.0, 0.0, 300.0, 200.0]), np.zeros(3))
    grey, choice = np.zeros((40, 60), np.uint8), FaceChoice()

    def awaited(*certain):
        """Whether a face is awaited that was tracked, with or without certainty in each frame, and lost."""
        choice.lose(fit)
        choice.misses = 1000
        assert choice.pick(grey, [], PerformerIdentity()) is None and choice.anybody
        for one in certain:
            choice.settle(certain=one)
        choice.end_wait()
        choice.lose(fit)
        return choice.waiting

    assert not awaited(False, False)
    assert awaited(False, True, False)
    assert not awaited(False)
    choice.request(10.0, 20.0)
    assert awaited(False)
