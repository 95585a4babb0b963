"""The reference video of a take."""

import os
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from facemime.core.puppet.reference_video import ReferenceVideo
from tests.helpers.clocks import PATIENCE


def picture(level: int, size: tuple[int, int] = (48, 64)) -> np.ndarray:
    """A grey image of brightness `level`."""
    return np.full((*size, 3), level, np.uint8)


def levels(path) -> list[int]:
    """Return the brightness of each frame of a video."""
    video, found = cv2.VideoCapture(str(path)), []
    while (frame := video.read())[0]:
        found.append(round(float(frame[1].mean())))
    return found


@pytest.fixture
def path(tmp_path):
    return tmp_path / "take.mkv"


def test_frames_are_shown_at_their_times_however_uneven(path):
    video = ReferenceVideo(path, 25.0)
    for seconds, level in ((0.0, 40), (0.041, 80), (0.20, 120), (0.21, 160), (0.32, 200)):
        video.add(seconds, picture(level))
    video.close()
    assert video.written
    assert levels(path) == pytest.approx([40, 80, 80, 80, 80, 120, 160, 160, 200], abs=6)


def test_changing_sizes_and_grey_images_are_accepted(path):
    video = ReferenceVideo(path, 25.0)
    video.add(0.0, picture(40))
    video.add(0.04, picture(80, (96, 128)))
    video.add(0.08, picture(120)[..., 0])
    video.close()
    assert levels(path) == pytest.approx([40, 80, 120], abs=6)


def test_without_frames_there_is_no_file(path):
    video = ReferenceVideo(path, 25.0)
    video.close()
    assert not path.exists() and not video.written


def test_a_missing_folder_is_reported(tmp_path):
    video = ReferenceVideo(tmp_path / "none" / "take.mkv", 25.0)
    video.add(0.0, picture(40))
    video.close()
    assert not video.written


def test_a_killed_process_loses_less_than_a_second_of_video(path):
    code = (
        "import os, sys, time, numpy as np\n"
        "from pathlib import Path\n"
        "from facemime.core.puppet.reference_video import ReferenceVideo\n"
        "video = ReferenceVideo(Path(sys.argv[1]), 25.0)\n"
        "still = np.full((240, 320, 3), 80, np.uint8)\n"
        "for n in range(200):\n"
        "    video.add(n / 25.0, still)\n"
        "    while video._waiting.qsize() > 8: time.sleep(0.001)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code, str(path)], env=os.environ, check=False)
    assert abs(ended.returncode) == 9
    end = time.monotonic() + PATIENCE
    while (count := len(levels(path)) if path.exists() else 0) < 175:
        assert time.monotonic() < end, f"only {count} of 200 frames, a second is 25"
        time.sleep(0.1)
