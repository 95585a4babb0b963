"""Tracking of a video tells what the file lacks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.cli import main as cli
from facemime.core.files.capture import read_image
from facemime.core.takes.file import load_take
from facemime.core.takes.from_video import track_video
from facemime.core.tracking.identity import LEFTMOST
from tests.helpers.commands import SAMPLE

PORTRAITS = Path(__file__).parents[2] / "data" / "portraits"


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    """The first two seconds of the sample clip, in a file that states its length at the beginning."""
    path = tmp_path_factory.mktemp("clip") / "clip.avi"
    source = cv2.VideoCapture(str(SAMPLE))
    size = tuple(int(source.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, size)
    for _ in range(50):
        writer.write(source.read()[1])
    writer.release()
    return path


def test_a_video_that_was_cut_is_tracked_as_far_as_it_goes_and_the_take_says_what_is_missing(clip, tmp_path, capsys):
    cut, output = tmp_path / "cut.avi", tmp_path / "take.facetake"
    cut.write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    assert cli.main(["track", str(cut), "-o", str(output)]) == 0
    take = load_take(output)
    end = take.times[-1]
    assert 5 < len(take) < 40 and take.found.all()
    assert take.info["recovered"] == f"The video was cut or damaged. Missing: {2.0 - end:.2f} s after {end:.2f} s."
    assert take.info["recovered"] in capsys.readouterr().err


def test_nothing_is_said_of_a_whole_video(clip, tmp_path, capsys):
    output = tmp_path / "take.facetake"
    assert cli.main(["track", str(clip), "-o", str(output)]) == 0
    assert len(load_take(output)) == 50 and "recovered" not in load_take(output).info
    assert "Missing" not in capsys.readouterr().err


@pytest.mark.parametrize("side", [None, LEFTMOST])
def test_the_face_of_each_of_unrelated_photographs_is_found(tmp_path, side):
    corners = [(0, 0), (500, 900), (0, 900), (500, 0), (250, 450), (0, 0)]
    for number, (top, left) in enumerate(corners):
        portrait = read_image(PORTRAITS / ("collins.jpg", "hopper.jpg")[number % 2])
        small = cv2.resize(portrait, (400, 400 * portrait.shape[0] // portrait.shape[1]))[:400]
        photograph = np.full((900, 1300, 3), 40 + 30 * number, np.uint8)
        photograph[top : top + len(small), left : left + 400] = small
        cv2.imwrite(str(tmp_path / f"{number}.png"), photograph)
    take = track_video(tmp_path, face=side)
    assert take.found.all()
    for (top, left), pose in zip(corners, take.pose, strict=True):
        assert left < pose[4] < left + 400 and top < pose[5] < top + 400
