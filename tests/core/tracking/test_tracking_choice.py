"""Choice of the face to track when several are in view."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.cli import main as cli
from facemime.cli.options import face_of
from facemime.core.errors import FacemimeError
from facemime.core.puppet.sources import LiveFrame, LiveSource
from facemime.core.puppet.worker import LiveOptions, LiveWorker
from facemime.core.takes.file import load_take
from facemime.core.tracking.identity import LEFTMOST, RIGHTMOST
from facemime.core.tracking.tracker import FaceTracker

SAMPLE = Path(__file__).parents[3] / "assets" / "sample" / "sample.mp4"


@pytest.fixture(scope="module")
def crowd() -> np.ndarray:
    """Three people side by side, the middle one the largest; x of their faces is about 130, 470 and 830."""
    frame = cv2.VideoCapture(str(SAMPLE)).read()[1]
    picture = np.full((400, 960, 3), 90, np.uint8)
    for left, right, face in ((0, 260, frame), (260, 700, cv2.flip(frame, 1)), (700, 960, frame)):
        size = (right - left, 400)
        factor = size[0] / 440
        matrix = np.float32([[factor, 0, size[0] / 2 - factor * 320], [0, factor, 200 - factor * 240]])
        picture[:, left:right] = cv2.warpAffine(face, matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return picture


def person(result) -> str:
    """Return whose face it is."""
    x = float(result.landmarks[:, 0].mean())
    return "left" if x < 260 else "middle" if x < 700 else "right"


def test_the_largest_face_is_tracked_and_the_outermost_if_chosen(tracker: FaceTracker, crowd: np.ndarray) -> None:
    tracker.reset()
    assert person(tracker.track(crowd)) == "middle"
    tracker.choose(*LEFTMOST)
    assert [person(tracker.track(crowd)) for _ in range(4)] == ["left"] * 4
    tracker.choose(*RIGHTMOST)
    assert [person(tracker.track(crowd)) for _ in range(4)] == ["right"] * 4


def test_the_next_face_is_to_the_right_and_wraps_around(tracker: FaceTracker, crowd: np.ndarray) -> None:
    tracker.reset()
    seen = [person(tracker.track(crowd))]
    for _ in range(3):
        tracker.choose_next()
        seen.append(person(tracker.track(crowd)))
        assert person(tracker.track(crowd)) == seen[-1]
    assert seen == ["middle", "right", "left", "middle"]


def test_a_single_face_stays_when_another_is_requested(tracker: FaceTracker, crowd: np.ndarray) -> None:
    alone = crowd[:, 260:700]
    tracker.reset()
    before = tracker.track(alone)
    tracker.choose_next()
    after = tracker.track(alone)
    assert after.found
    np.testing.assert_allclose(after.landmarks, before.landmarks, atol=3.0)


def test_requesting_another_face_before_the_first_frame_changes_nothing(
    tracker: FaceTracker, crowd: np.ndarray
) -> None:
    tracker.reset()
    tracker.choose_next()
    assert person(tracker.track(crowd)) == "middle"


class Still(LiveSource):
    """The same image, endlessly."""

    name = "still"

    def __init__(self, picture: np.ndarray) -> None:
        self.picture, self.count = picture, 0

    def read(self, timeout: float) -> LiveFrame:
        self.count += 1
        return LiveFrame(self.count / 25.0, self.picture)

    def close(self) -> None:
        pass


def test_a_running_session_tracks_the_chosen_face(crowd: np.ndarray) -> None:
    worker = LiveWorker(Still(crowd), options=LiveOptions(smoothing=0.0))

    def next_person() -> str:
        """The face that is tracked two frames later."""
        number = worker.counts.tracked
        while worker.running and worker.counts.tracked < number + 2:
            worker._stop.wait(0.002)
        return person(worker.latest.result)

    worker.start()
    try:
        while worker.latest is None:
            assert worker.running
            worker._stop.wait(0.002)
        assert next_person() == "middle"
        worker.options = LiveOptions(smoothing=0.0, face=LEFTMOST)
        assert next_person() == "left"
        worker.follow_next()
        assert next_person() == "middle"
        worker.options = LiveOptions(smoothing=0.0)
        assert next_person() == "middle"
    finally:
        worker.close()


def test_the_command_tracks_the_chosen_face(crowd: np.ndarray, tmp_path: Path) -> None:
    video = str(tmp_path / "crowd.avi")
    writer = cv2.VideoWriter(video, cv2.VideoWriter_fourcc(*"MJPG"), 25.0, crowd.shape[1::-1])
    for _ in range(3):
        writer.write(crowd)
    writer.release()
    for name, wanted in (("left", "left"), ("right", "right"), ("470,200", "middle")):
        output = tmp_path / f"{wanted}.facetake"
        assert cli.main(["track", video, "-o", str(output), "--face", name]) == 0
        take = load_take(output)
        assert {person(take.result(i)) for i in range(len(take))} == {wanted}


@pytest.mark.parametrize("text", ["centre", "1", "1,2,3", "a,b", "nan,nan", "1.5,2"])
def test_invalid_faces_are_refused_with_advice(text: str) -> None:
    with pytest.raises(FacemimeError, match="left, right, or pixels"):
        face_of(text)


@pytest.mark.parametrize(("text", "place"), [("", None), ("left", LEFTMOST), ("12,34", (12.0, 34.0))])
def test_a_face_is_chosen_by_side_or_position(text: str, place: tuple[float, float] | None) -> None:
    assert face_of(text) == place
