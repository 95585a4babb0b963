"""Tracking of a video tells what the file lacks."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from facemime.cli import main as cli
from facemime.core.takes.file import load_take
from tests.helpers.commands import SAMPLE


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
