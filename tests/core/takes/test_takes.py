"""Takes, and atomic writing of files."""

import os
import stat
from dataclasses import replace

import numpy as np
import pytest

from facemime.core.base.errors import OutputError, SourceError
from facemime.core.base.writing import check_writable, replacing
from facemime.core.takes.take import TakeRecorder, check_take
from facemime.core.tracking.result import TrackResult


def recording(count: int = 5) -> TakeRecorder:
    """A recording in which the second frame is lost."""
    rng = np.random.default_rng(0)
    recorder = TakeRecorder({"source": "clip.mp4", "fps": 25.0})
    for i in range(count):
        found = i != 1
        fill = 1.0 if found else np.nan
        recorder.append(
            i / 25.0,
            TrackResult(
                found,
                fill * rng.normal(size=(66, 2)),
                fill * rng.normal(size=6),
                fill * rng.normal(size=4),
                fill * rng.normal(size=(66, 3)),
                0.5,
                fill * rng.random(66),
                fill * rng.normal(size=(2, 2)),
                fill * rng.normal(size=2),
            ),
        )
    return recorder


def test_times_must_increase_and_an_empty_recording_is_refused():
    recorder = recording()
    with pytest.raises(ValueError, match="must increase"):
        recorder.append(0.1, recorder._results[0])
    with pytest.raises(SourceError, match="has no frames"):
        TakeRecorder({}).finish()


def test_a_part_has_the_chosen_frames_and_inconsistent_arrays_are_refused():
    take = recording().finish()
    assert take.part(slice(1, 3)).times.tolist() == [1 / 25.0, 2 / 25.0]
    assert len(take.part(take.found)) == 4
    check_take(take)
    with pytest.raises(ValueError, match="gaze has the shape"):
        check_take(replace(take, gaze=take.gaze[:2]))
    with pytest.raises(ValueError, match="contain no numbers"):
        check_take(replace(take, found=np.ones(5, bool)))
    with pytest.raises(ValueError, match="do not increase"):
        check_take(replace(take, times=take.times[::-1]))


def test_a_failed_write_leaves_only_the_old_file(tmp_path):
    path = tmp_path / "out.facetake"
    path.write_text("good")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("stopped")
    assert path.read_text() == "good"
    assert os.listdir(tmp_path) == ["out.facetake"]


def test_a_full_disk_is_one_clear_error(tmp_path):
    path = tmp_path / "out.facetake"
    path.write_text("good")
    with pytest.raises(OutputError, match="no space left"), replacing(path), open("/dev/full", "wb") as stream:
        stream.write(b"x" * 100_000)
    assert path.read_text() == "good"


def test_a_new_file_has_default_permissions(tmp_path):
    with replacing(tmp_path / "out.txt") as temporary:
        temporary.write_text("x")
    (tmp_path / "plain.txt").write_text("x")
    assert stat.S_IMODE((tmp_path / "out.txt").stat().st_mode) == stat.S_IMODE((tmp_path / "plain.txt").stat().st_mode)


def test_outputs_that_cannot_be_written_are_refused_before_the_work(tmp_path):
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, tmp_path / "file" / "out.facetake", "/proc/out.facetake"):
        with pytest.raises(OutputError, match="Cannot write"):
            check_writable(path)
    with pytest.raises(OutputError, match=r"suffix \.jpg or \.png"):
        check_writable(tmp_path / "out.avi", {".png", ".jpg"})
    check_writable(tmp_path / "new" / "out.facetake", {".facetake"})
    assert not (tmp_path / "new").exists()
