"""The sample clip and the landmarks beside it."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.base.landmarks import from_ibug

SAMPLE = Path(__file__).parents[2] / "assets" / "sample"


@pytest.fixture(scope="module")
def truth():
    with np.load(SAMPLE / "sample_landmarks.npz") as file:
        return {key: file[key] for key in file.files}


@pytest.fixture(scope="module")
def frames():
    capture = cv2.VideoCapture(str(SAMPLE / "sample.mp4"))
    images, times = [], []
    while True:
        ok, image = capture.read()
        if not ok:
            return images, np.array(times), capture.get(cv2.CAP_PROP_FPS)
        images.append(image)
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)


def span(points: np.ndarray, a: int, b: int) -> np.ndarray:
    first, second = from_ibug([a, b])
    return np.linalg.norm(points[:, first] - points[:, second], axis=-1)


def during(truth: dict, label: str) -> np.ndarray:
    rows = truth["labels"] == label
    assert rows.any(), f"nothing is labelled {label}"
    return truth["landmarks"][rows]


def test_the_clip_is_small_and_has_the_size_of_a_webcams(frames):
    images, _, fps = frames
    assert (SAMPLE / "sample.mp4").stat().st_size < 1_000_000
    assert fps == pytest.approx(25)
    assert {image.shape for image in images} == {(480, 640, 3)}


def test_there_is_one_row_of_landmarks_for_every_frame_at_its_time(truth, frames):
    images, times, _ = frames
    assert truth["landmarks"].shape == (len(images), 66, 2)
    assert len(truth["pose"]) == len(truth["labels"]) == len(images)
    assert np.allclose(truth["times"], times, atol=0.002)


def test_landmarks_lie_within_the_image(truth):
    assert truth["landmarks"].min() > 0
    assert (truth["landmarks"] < [640, 480]).all()


def test_the_first_second_is_neutral_and_every_act_follows(truth):
    early = truth["labels"][truth["times"] < 1.0]
    assert set(early) <= {"neutral", "blink"}
    acts = {"smile", "mouth open", "pucker", "frown", "brows up", "blink", "sneer", "turn left", "turn right", "nod"}
    assert acts <= set(truth["labels"])
    assert truth["labels"][-1] == "neutral"


def test_the_mouth_widens_in_a_smile_and_narrows_in_a_pucker(truth):
    rest = np.median(span(during(truth, "neutral"), 48, 54))
    assert span(during(truth, "smile"), 48, 54).max() > 1.12 * rest
    assert span(during(truth, "pucker"), 48, 54).min() < 0.92 * rest


def test_the_mouth_opens_wide_and_the_eyes_close_fully(truth):
    rest = during(truth, "neutral")
    assert span(during(truth, "mouth open"), 62, 66).max() > 4 * np.median(span(rest, 62, 66))
    assert span(during(truth, "blink"), 38, 40).min() < 0.2 * np.median(span(rest, 38, 40))


def test_brows_rise_and_fall(truth):
    rest = np.median(span(during(truth, "neutral"), 24, 44))
    assert span(during(truth, "brows up"), 24, 44).max() > 1.1 * rest
    assert span(during(truth, "frown"), 24, 44).min() < 0.95 * rest


def test_the_head_turns_both_ways_according_to_the_pose(truth):
    points, yaw = truth["landmarks"], truth["pose"][:, 1]
    right, left, nose = (points[:, i, 0] for i in from_ibug([36, 45, 30]))
    offset = (nose - (right + left) / 2) / (left - right)
    assert np.degrees(yaw.max()) > 15 and np.degrees(yaw.min()) < -15
    assert np.corrcoef(offset, yaw)[0, 1] < -0.98  # a positive yaw turns the nose to the left of the picture
