"""Takes, and files that are replaced only by whole ones."""

import os
import stat

import numpy as np
import pytest

from facemime.core.errors import OutputError, SourceError
from facemime.core.files import check_writable, replacing
from facemime.core.takes.take import _FIELDS, TakeRecorder, load_take, save_take
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


def test_a_saved_take_is_the_same_when_loaded(tmp_path):
    take = recording().finish()
    save_take(take, tmp_path / "take.npz")
    loaded = load_take(tmp_path / "take.npz")
    for name in _FIELDS:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(take, name))
    assert loaded.info == take.info
    assert not loaded.result(1).found
    assert loaded.result(2).landmarks.shape == (66, 2)


def test_a_take_cut_at_any_point_is_refused_in_one_sentence(tmp_path):
    whole = tmp_path / "take.npz"
    save_take(recording().finish(), whole)
    data = whole.read_bytes()
    for cut in range(0, len(data), 97):
        (tmp_path / "cut.npz").write_bytes(data[:cut])
        with pytest.raises(SourceError, match="not a take"):
            load_take(tmp_path / "cut.npz")


def test_a_take_of_the_first_format_loads_and_tells_no_gaze(tmp_path):
    save_take(recording().finish(), tmp_path / "take.npz")
    with np.load(tmp_path / "take.npz") as file:
        arrays = {name: file[name] for name in file.files if name not in ("landmark_confidence", "pupils", "gaze")}
    arrays["header"] = np.array(str(arrays["header"]).replace('"version": 2', '"version": 1'))
    np.savez(tmp_path / "old.npz", **arrays)
    old = load_take(tmp_path / "old.npz")
    assert len(old) == 5 and np.isnan(old.gaze).all() and np.isnan(old.landmark_confidence).all()
    assert np.isnan(old.result(0).gaze).all()
    np.savez(tmp_path / "new.npz", **{**arrays, "header": np.array(str(arrays["header"]).replace(": 1,", ": 2,"))})
    with pytest.raises(SourceError, match="not a take"):
        load_take(tmp_path / "new.npz")


def test_foreign_files_and_inconsistent_takes_are_refused(tmp_path):
    np.savez(tmp_path / "foreign.npz", a=np.zeros(3))
    with pytest.raises(SourceError, match="not a take"):
        load_take(tmp_path / "foreign.npz")
    with pytest.raises(SourceError, match="no take"):
        load_take(tmp_path / "missing.npz")
    take = recording().finish()
    take.shape[0] = np.nan
    save_take(take, tmp_path / "nan.npz")
    with pytest.raises(SourceError, match="hold no numbers"):
        load_take(tmp_path / "nan.npz")


def test_times_must_increase_and_an_empty_recording_is_refused():
    recorder = recording()
    with pytest.raises(ValueError, match="must increase"):
        recorder.append(0.1, recorder._results[0])
    with pytest.raises(SourceError, match="gave no frame"):
        TakeRecorder({}).finish()


def test_a_failure_while_writing_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "out.npz"
    path.write_text("good")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("stopped")
    assert path.read_text() == "good"
    assert os.listdir(tmp_path) == ["out.npz"]


def test_a_full_disk_is_one_clear_error(tmp_path):
    path = tmp_path / "out.npz"
    path.write_text("good")
    with pytest.raises(OutputError, match="no space left"), replacing(path), open("/dev/full", "wb") as stream:
        stream.write(b"x" * 100_000)
    assert path.read_text() == "good"


def test_a_replaced_file_has_the_permissions_of_a_new_one(tmp_path):
    with replacing(tmp_path / "out.txt") as temporary:
        temporary.write_text("x")
    (tmp_path / "plain.txt").write_text("x")
    assert stat.S_IMODE((tmp_path / "out.txt").stat().st_mode) == stat.S_IMODE((tmp_path / "plain.txt").stat().st_mode)


def test_outputs_that_cannot_be_written_are_refused_before_the_work(tmp_path):
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, tmp_path / "file" / "out.npz", "/proc/out.npz"):
        with pytest.raises(OutputError, match="Cannot write"):
            check_writable(path)
    with pytest.raises(OutputError, match=r"suffix \.jpg or \.png"):
        check_writable(tmp_path / "out.avi", {".png", ".jpg"})
    check_writable(tmp_path / "new" / "out.npz", {".npz"})
    assert not (tmp_path / "new").exists()
