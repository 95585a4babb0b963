"""Results of the command line survive interruptions, kills, second runs and failed writes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from facemime.cli import job_files, landmarks
from facemime.cli import main as cli
from facemime.core.files.capture import write_image
from facemime.core.takes.file import load_take, save_take
from tests.helpers.commands import SAMPLE, START, broken_off, needs_posix, run
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


@needs_posix
@pytest.mark.parametrize(("by", "status"), first_of([(signal.SIGINT, 130), (signal.SIGTERM, 143)], rows=True))
def test_an_interrupted_run_never_replaces_a_complete_take(take, tmp_path, by, status):
    whole = take.read_bytes()
    unfinished = tmp_path / "take.unfinished.facetake"
    for part in ("take.interrupted.facetake", "take.interrupted-2.facetake"):
        ended, said = broken_off("track", SAMPLE, "-o", take, when=unfinished, by=by)
        assert ended == status and "Traceback" not in said and f"are in {tmp_path / part}." in said, said
        assert take.read_bytes() == whole and 0 < len(load_take(tmp_path / part)) < 255
    names = {"take.facetake", "take.interrupted.facetake", "take.interrupted-2.facetake"}
    assert set(os.listdir(tmp_path)) == names


def test_an_interrupted_run_never_replaces_complete_landmarks(tmp_path, monkeypatch, capsys):
    image = np.full((60, 60, 3), 90, np.uint8)
    for name in ("a.png", "b.png"):
        write_image(tmp_path / "in" / name, image)
    line = ["landmarks", str(tmp_path / "in"), "-o", str(tmp_path / "out.npz")]
    assert cli.main(line) == 0
    whole, read = (tmp_path / "out.npz").read_bytes(), landmarks.read_image

    def interrupt(path):
        if path.name == "b.png":
            raise KeyboardInterrupt
        return read(path)

    monkeypatch.setattr(landmarks, "read_image", interrupt)
    assert cli.main(line) == 130
    assert f"the results of the first 1 images are in {tmp_path / 'out.interrupted.npz'}" in capsys.readouterr().err
    assert (tmp_path / "out.npz").read_bytes() == whole
    assert np.load(tmp_path / "out.interrupted.npz")["names"].tolist() == ["a.png"]


@needs_posix
def test_images_are_not_overwritten_through_links(tmp_path, capsys):
    picture = tmp_path / "in" / "a.png"
    write_image(picture, np.full((60, 60, 3), 90, np.uint8))
    (tmp_path / "drawn").mkdir()
    (tmp_path / "drawn" / "a.png").symlink_to(picture)
    before = picture.read_bytes()
    line = ["landmarks", str(picture), "-o", str(tmp_path / "out.npz"), "--overlay", str(tmp_path / "drawn")]
    assert cli.main(line) == 1 and "Choose another folder for --overlay" in capsys.readouterr().err
    assert picture.read_bytes() == before


@pytest.mark.thorough
@needs_posix
def test_later_runs_keep_what_a_killed_run_tracked(tmp_path):
    output, left = tmp_path / "take.facetake", tmp_path / "take.unfinished.facetake"
    broken_off("track", SAMPLE, "-o", output, when=left, by=signal.SIGKILL)
    job_files = left.read_bytes()
    assert 0 < len(load_take(left)) < 255
    (tmp_path / "junk.mp4").write_text("no video")
    for video, status in ((tmp_path / "junk.mp4", 1), (SAMPLE, 0)):
        done = run("track", video, "-o", output)
        assert done.returncode == status and f"{left} is from an earlier run" in done.stderr
    assert left.read_bytes() == job_files and len(load_take(output)) == 255
    assert set(os.listdir(tmp_path)) == {"take.facetake", "take.unfinished.facetake", "junk.mp4"}


@pytest.mark.thorough
@needs_posix
def test_a_killed_run_loses_at_most_a_second(tmp_path):
    output, left = tmp_path / "take.facetake", tmp_path / "take.unfinished.facetake"
    with subprocess.Popen([*START, "track", SAMPLE, "-o", output], stderr=subprocess.DEVNULL) as process:
        while not left.exists() or left.stat().st_size < 50_000:
            assert process.poll() is None
            time.sleep(0.005)
        process.kill()
    take = load_take(left)
    assert len(take) >= 26 and "up to a second after" in take.info["recovered"]


@pytest.mark.thorough
@needs_posix
def test_a_second_run_with_the_same_output_is_refused(tmp_path):
    output, unfinished = tmp_path / "take.facetake", tmp_path / "take.unfinished.facetake"
    with subprocess.Popen([*START, "track", SAMPLE, "-o", output], stderr=subprocess.PIPE, text=True) as first:
        while not unfinished.exists():
            assert first.poll() is None
            time.sleep(0.005)
        first.send_signal(signal.SIGSTOP)  # so that it does not finish before the second begins
        second = run("track", SAMPLE, "-o", tmp_path / "." / "take.facetake")
        first.send_signal(signal.SIGCONT)
        assert "Traceback" not in first.stderr.read()
    assert second.returncode == 1 and "Another facemime is writing" in second.stderr
    assert first.returncode == 0 and len(load_take(output)) == 255 and os.listdir(tmp_path) == ["take.facetake"]


@needs_posix
def test_a_take_that_cannot_replace_the_output_is_kept_and_reported(tmp_path, monkeypatch, capsys):
    clip, output = tmp_path / "clip.mp4", tmp_path / "take.facetake"
    shutil.copy(SAMPLE, clip)
    output.write_text("old")
    replace = os.replace

    def refuse(source, target):
        if Path(target) == output:
            raise PermissionError(1, "Operation not permitted")
        replace(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    monkeypatch.setattr(job_files, "track_video", lambda *arguments: save_take(performance(), arguments[3]))
    assert cli.main(["track", str(clip), "-o", str(output)]) == 1
    said = capsys.readouterr().err
    assert (
        "operation not permitted" in said and f"What was tracked is in {tmp_path / 'take.unfinished.facetake'}" in said
    )
    assert len(load_take(tmp_path / "take.unfinished.facetake")) == 60 and output.read_text() == "old"


@needs_posix
def test_a_take_is_never_mended_onto_itself(take, tmp_path, capsys):
    (tmp_path / "link.facetake").symlink_to(take)
    (tmp_path / "hard.facetake").hardlink_to(take)
    before = take.read_bytes()
    for name in ("take.facetake", "link.facetake", "hard.facetake"):
        assert cli.main(["mend", str(take), "-o", str(tmp_path / name), "--mirror"]) == 1
        assert "it is the take that is mended" in capsys.readouterr().err
    other = tmp_path / "other.facetake"
    save_take(performance(), other)
    assert cli.main(["mend", str(take), "-o", str(other), "--punch-in", str(other)]) == 1
    assert "it is the take that is inserted" in capsys.readouterr().err and take.read_bytes() == before


# Inputs
