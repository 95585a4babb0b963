"""Frames of a video by time, in any order."""

import os

import cv2
import numpy as np
import pytest

from facemime.core.errors import SourceError
from facemime.core.files.capture import VideoSource
from facemime.core.files.frame_finder import FrameFinder


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "numbered.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 20.0, (64, 48))
    for number in range(60):
        writer.write(np.full((48, 64, 3), 4 * number, np.uint8))
    writer.release()
    return path


def test_any_order_of_times_gives_the_frames_that_reading_in_order_does(video):
    frames = list(VideoSource(video))
    with FrameFinder(video) as finder:
        for index in (3, 4, 5, 4, 50, 49, 48, 3, 59, 0):
            np.testing.assert_array_equal(finder.at(frames[index].time), frames[index].image)


def test_there_is_no_frame_before_the_first_or_after_the_last(video):
    with FrameFinder(video) as finder:
        assert finder.at(-1.0) is None and finder.at(100.0) is None
        assert finder.at(0.0) is not None


@pytest.mark.skipif(os.name != "posix", reason="files that are open cannot be deleted")
def test_a_video_that_was_deleted_meanwhile_is_an_error_when_it_is_read_again(video, tmp_path):
    copy = tmp_path / "copy.mp4"
    copy.write_bytes(video.read_bytes())
    finder = FrameFinder(copy)
    assert finder.at(2.0) is not None
    copy.unlink()
    with pytest.raises(SourceError):
        finder.at(0.0)
    finder.close()
    finder.close()
