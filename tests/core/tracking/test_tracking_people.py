"""Everybody in a video is followed, and keeps their number through absences, swaps and cuts."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.errors import SourceError
from facemime.core.files.capture import read_image
from facemime.core.takes.file import load_take
from facemime.core.takes.from_video import numbered, track_people
from facemime.core.tracking.people import PeopleTracker
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.commands import run

PORTRAITS = Path(__file__).parents[2] / "data" / "portraits"
SIDE = 320


@pytest.fixture(scope="module")
def tracker() -> FaceTracker:
    return FaceTracker.load()


@pytest.fixture(scope="module")
def faces(tracker: FaceTracker) -> list[np.ndarray]:
    """Two people, each in the middle of a square image."""
    pictures = []
    for name in ("collins.jpg", "hopper.jpg"):
        image = read_image(PORTRAITS / name)
        pose = tracker.locate(image).pose
        scale = 70.0 / pose[0]
        shift = SIDE / 2.0 - scale * pose[4:6]
        matrix = np.column_stack([scale * np.eye(2), shift])
        pictures.append(cv2.warpAffine(image, matrix, (SIDE, SIDE), borderMode=cv2.BORDER_REPLICATE))
    return pictures


def beside(*pictures: np.ndarray, moved: int = 0) -> np.ndarray:
    """A frame with people side by side, moved down by a few pixels."""
    return np.roll(np.hstack(pictures), moved, axis=0)


def empty() -> np.ndarray:
    return np.full((SIDE, SIDE, 3), 128, np.uint8)


def places(results) -> dict[int, int]:
    """Place of each person in a row, from 0, by their number."""
    return {number: int(result.pose[4] // SIDE) for number, result in results.items()}


def test_everybody_in_view_is_followed_from_the_first_frame(tracker, faces):
    people = PeopleTracker(tracker)
    first = places(people.track(beside(*faces)))
    assert sorted(first.values()) == [0, 1]
    for moved in range(1, 8):
        assert places(people.track(beside(*faces, moved=moved))) == first


def test_who_leaves_and_returns_elsewhere_keeps_their_number(tracker, faces):
    people = PeopleTracker(tracker)
    first = places(people.track(beside(*faces, empty())))
    left = next(number for number, place in first.items() if place == 0)
    for _ in range(4):
        assert places(people.track(beside(empty(), faces[1], empty()))).keys() == first.keys() - {left}
    for _ in range(4):
        last = places(people.track(beside(empty(), faces[1], faces[0])))
    assert last == {**first, left: 2}


def test_a_cut_that_swaps_two_people_swaps_their_numbers(tracker, faces):
    people = PeopleTracker(tracker)
    first = places(people.track(beside(*faces)))
    assert places(people.track(beside(*faces[::-1]))) == {number: 1 - place for number, place in first.items()}


def test_a_cut_to_somebody_at_the_same_place_is_noticed(tracker, faces):
    people = PeopleTracker(tracker)
    for _ in range(4):
        assert list(people.track(faces[0])) == [0]
    for _ in range(4):
        assert list(people.track(faces[1])) == [1]
    assert list(people.track(faces[0])) == [0]


def test_no_face_gives_no_result(tracker):
    people = PeopleTracker(tracker)
    assert [people.track(beside(empty(), empty())) for _ in range(3)] == [{}] * 3


def write(path: Path, frames: list[np.ndarray]) -> Path:
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (width, height))
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def test_each_person_has_a_take_of_the_whole_video(tracker, faces, tmp_path):
    video = write(tmp_path / "two.mp4", [beside(faces[0], empty())] * 10 + [beside(*faces)] * 20)
    one, other = track_people(video, tracker)
    assert len(one) == len(other) == 30 and one.info["person"] == 1 and other.info["person"] == 2
    assert one.found.all() and not other.found[:10].any() and other.found[-8:].all()
    np.testing.assert_array_equal(one.times, other.times)


def test_who_is_hardly_seen_has_no_take(tracker, faces, tmp_path):
    video = write(tmp_path / "two.mp4", [beside(*faces)] * 5 + [beside(faces[0], empty())] * 25)
    (only,) = track_people(video, tracker)
    assert only.found.all()
    with pytest.raises(SourceError, match="No face was found"):
        track_people(write(tmp_path / "none.mp4", [empty()] * 3), tracker)


def test_the_command_writes_a_numbered_take_of_everybody(faces, tmp_path):
    video = write(tmp_path / "two.mp4", [beside(*faces)] * 15)
    done = run("track", video, "-o", tmp_path / "talk.facetake", "--faces", "all")
    assert done.returncode == 0, done.stderr
    takes = sorted(path.name for path in tmp_path.glob("*.facetake"))
    assert takes == ["talk-1.facetake", "talk-2.facetake"]
    assert all(load_take(tmp_path / name).found.all() for name in takes)
    assert numbered(tmp_path / "talk.facetake", 1) == tmp_path / "talk-2.facetake"


def test_a_folder_of_pictures_is_tracked_like_a_video(faces, tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(12):
        cv2.imwrite(str(folder / f"{number}.png"), faces[0])
    done = run("track", folder, "-o", tmp_path / "talk.facetake", "--rate", "10")
    assert done.returncode == 0, done.stderr
    take = load_take(tmp_path / "talk.facetake")
    assert take.found.all()
    np.testing.assert_allclose(take.times, np.arange(12) / 10.0)
