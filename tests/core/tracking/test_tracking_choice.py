"""Choice of the face to track when several are in view."""

from __future__ import annotations

from collections.abc import Iterator
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
from facemime.core.takes.from_video import track_video
from facemime.core.tracking.identity import LEFTMOST, RIGHTMOST
from facemime.core.tracking.rivals import Rivals
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


def test_the_neighbour_is_not_taken_while_the_chosen_face_is_out_of_view(tracker: FaceTracker) -> None:
    sample = [frame[90:390, 180:460] for frame in sample_frames(45)]
    neighbour = cv2.VideoCapture(str(SAMPLE)).read()[1][90:390, 180:460]
    # Somebody else: of the same size and in the same light, but with another face.
    neighbour = cv2.warpAffine(neighbour, np.float32([[0.8, 0, 28], [0, 1.1, -15]]), (280, 300), borderMode=1)
    seen = []
    tracker.choose(*LEFTMOST)
    for number, frame in enumerate(sample):
        hidden = 5 <= number < 30
        result = tracker.track(np.hstack([np.full_like(frame, 90) if hidden else frame, neighbour]))
        seen.append(result.found and ("own" if result.pose[4] < 280 else "neighbour"))
    assert set(seen[:5]) == {"own"}
    assert not any(seen[5:30])
    assert set(seen[-10:]) == {"own"}


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


def beside_a_picture(count: int, *, mirrored: bool = False) -> Iterator[np.ndarray]:
    """Frames of a performer beside a larger picture, on the left unless mirrored, of another moment."""
    video = cv2.VideoCapture(str(SAMPLE))
    picture = cv2.resize(video.read()[1], None, fx=1.4, fy=1.4)[90:570, 150:750]
    for _ in range(count):
        frame = np.hstack([picture, video.read()[1]])
        yield cv2.flip(frame, 1) if mirrored else frame


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_performer_is_followed_instead_of_a_larger_picture(tracker: FaceTracker, mirrored: bool) -> None:
    tracker.reset()
    places = [tracker.track(frame).pose[4] > 620 for frame in beside_a_picture(40, mirrored=mirrored)]
    assert places[0] == mirrored  # the picture, as it is larger
    assert set(places[25:]) == {not mirrored}


def test_a_video_is_tracked_from_its_first_frame_on_the_performer_beside_a_picture(tmp_path: Path) -> None:
    for number, frame in enumerate(beside_a_picture(60)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), frame)
    take = track_video(tmp_path)
    assert take.found.all()
    assert take.pose[:, 4].min() > 620


def test_a_picture_is_followed_if_nobody_moves_or_if_it_was_chosen(tracker: FaceTracker) -> None:
    still = next(beside_a_picture(1))
    assert tracker.performer([still] * 30) is None
    tracker.reset()
    assert {tracker.track(still).pose[4] > 620 for _ in range(30)} == {False}
    tracker.choose(*LEFTMOST)
    assert {tracker.track(frame).pose[4] > 620 for frame in beside_a_picture(40)} == {False}


def test_the_largest_face_is_followed_if_all_move(tracker: FaceTracker) -> None:
    tracker.reset()
    frames = [np.hstack([cv2.resize(f, None, fx=1.4, fy=1.4)[90:570, 150:750], f]) for f in sample_frames(40)]
    assert {tracker.track(frame).pose[4] > 620 for frame in frames} == {False}
    assert tracker.performer(frames) is None


def test_somebody_who_comes_into_view_beside_a_picture_is_followed(tracker: FaceTracker) -> None:
    tracker.reset()
    frames = list(beside_a_picture(100))
    for frame in frames[:30]:
        frame[:, 600:] = 90
    places = [tracker.track(frame).pose[4] > 620 for frame in frames]
    assert not any(places[:30])
    assert all(places[-10:])


@pytest.mark.parametrize(("second", "chosen"), [(50.0, 450.0), (60.0, 450.0), (70.0, 450.0), (90.0, 750.0)])
def test_of_performers_about_as_large_the_surest_one_is_followed(second: float, chosen: float) -> None:
    rng = np.random.default_rng(0)
    still = rng.integers(0, 255, (300, 300))
    poses = [
        np.array([scale, 0.0, 0.0, 0.0, x, 150.0]) for scale, x in ((100.0, 150.0), (60.0, 450.0), (second, 750.0))
    ]
    frames = [np.hstack([still, rng.integers(0, 255, (300, 600))]).astype(np.uint8) for _ in range(3)]
    rivals = Rivals(frames[0], poses[0], poses[1:])
    for frame in frames[1:]:
        rivals.watch(frame)
    performing = rivals.performing()
    assert performing is not None
    assert performing[4] == chosen


def sample_frames(count: int) -> Iterator[np.ndarray]:
    """Frames of the sample."""
    video = cv2.VideoCapture(str(SAMPLE))
    return (video.read()[1] for _ in range(count))
