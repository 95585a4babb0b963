"""Times of tables survive clocks that are set, titles of any program, and rates that only the user knows."""

from __future__ import annotations

import re

import numpy as np
import pytest

from facemime.cli.main import main
from facemime.core.errors import SourceError
from facemime.core.takes.file import load_take
from facemime.core.takes.recordings import read_recording
from tests.helpers.recordings import openface
from tests.helpers.tables import stamps, table_lines


@pytest.fixture
def read(tmp_path):
    """Write a table with times under a title, and read it."""

    def write(times, title="Timecode", fps=None):
        (tmp_path / "table.csv").write_text("\n".join(table_lines(times, title)))
        return read_recording(tmp_path / "table.csv", fps=fps)

    return write


def notes(take):
    return " ".join(take.info.get("notes", []))


JUMPS = {
    "first row before the clock is set": ["00:00:00:00.000", *stamps(120)],
    "forward": stamps(60) + stamps(61, clock="14:00"),
    "backward": stamps(60) + stamps(61, clock="08:00"),
    "one row without a clock": [*stamps(60), "00:00:00:00.000", *stamps(60, start=61)],
    "several": stamps(40) + stamps(40, clock="12:00") + stamps(41, clock="15:00"),
}


@pytest.mark.parametrize("times", JUMPS.values(), ids=JUMPS)
def test_a_jump_of_the_timecode_is_closed_and_said(read, times):
    take = read(times)
    np.testing.assert_allclose(take.times, np.arange(121) / 60, atol=1e-6)
    assert "Jumps" in notes(take)


@pytest.mark.parametrize("pause", [5.0, 50.0])
def test_a_pause_of_a_recording_is_kept(read, pause):
    times = [*np.arange(90) / 30, *(3.0 + pause + np.arange(90) / 30)]
    take = read(times, "time")
    np.testing.assert_allclose(take.times, times, atol=1e-6)
    assert not notes(take)


def test_a_long_pause_within_a_longer_recording_is_kept(read):
    times = np.concatenate([np.arange(1000), 1300 + np.arange(1000)]) / 10.0
    np.testing.assert_allclose(read(times, "time (s)").times, times, atol=1e-6)


@pytest.mark.parametrize("times", [np.arange(20) * 120.0, np.array([0.0, 90.0, 100.0, 300.0]), np.array([0.0, 600.0])])
def test_the_long_steps_of_a_sparse_table_are_kept(read, times):
    np.testing.assert_allclose(read(times, "time (s)").times, times)


TIMES = {
    "seconds": lambda i: f"{i / 60:.4f}",
    "milliseconds": lambda i: f"{1000 * i / 60:.1f}",
    "nanoseconds": lambda i: f"{i * 16666667}",
    "since 1970": lambda i: f"{1700000000 + i / 60:.4f}",
    "clock": lambda i: f"00:00:{i / 60:06.3f}",
    "date": lambda i: f"2024-05-01 10:00:{i / 60:06.3f}",
    "written date": lambda i: f"01/05/2024, 10:00:{i / 60:06.3f}",
    "frames": lambda i: f"10:20:{i // 60:02d}:{i % 60:02d}",
}
"""How times of 60 frames per second are written."""
TITLES = {
    "datetime": "date",
    "Date Time": "written date",
    "unix_timestamp": "since 1970",
    "frame_time": "seconds",
    "frame_timestamp_ms": "milliseconds",
    "Time (HH:MM:SS)": "clock",
    "Recording Time [hh:mm:ss.mmm]": "clock",
    "video_time_ms": "milliseconds",
    "pts_time": "seconds",
    "captureTimestampNs": "nanoseconds",
    "timeSinceStart": "seconds",
    "Timecode (60 fps)": "frames",
    "SMPTE Timecode": "frames",
}


@pytest.mark.parametrize("title", TITLES)
def test_times_are_found_under_the_titles_of_other_programs(read, title):
    take = read([TIMES[TITLES[title]](i).replace(",", "") for i in range(90)], title)
    np.testing.assert_allclose(take.times, np.arange(90) / 60, atol=2e-3)
    assert not notes(take)


@pytest.mark.parametrize("title", ["lifetime", "exposure_time", "frame_time", "timestamp", "delta time"])
def test_a_column_that_stays_the_same_has_no_times(read, title):
    take = read([0.0167] * 30, title)
    np.testing.assert_allclose(take.times, np.arange(30) / 30)
    assert "rate was taken to be 30" in notes(take)


def test_durations_of_frames_are_not_their_times(read):
    take = read([f"{0.016 + 0.001 * (i % 3):.3f}" for i in range(30)], "frame_time")
    np.testing.assert_allclose(take.times, np.arange(30) / 30)


def test_frames_count_where_all_times_are_the_same(tmp_path):
    (tmp_path / "table.csv").write_text("\n".join(table_lines([f"0,{i}" for i in (1, 2, 4)], "timestamp,frame")))
    np.testing.assert_allclose(read_recording(tmp_path / "table.csv", fps=10.0).times, [0.0, 0.1, 0.3])


def test_openface_s_images_without_times_are_read_at_a_rate_that_is_said(tmp_path):
    rows = [{"frame": i + 1.0, "timestamp": 0.0, "AU26_r": float(i % 3)} for i in range(12)]
    (tmp_path / "images.csv").write_text(openface(rows))
    take = read_recording(tmp_path / "images.csv")
    np.testing.assert_allclose(take.times, np.arange(12) / 30)
    assert "30 frames per second" in notes(take)
    take = read_recording(tmp_path / "images.csv", fps=24.0)
    np.testing.assert_allclose(take.times, np.arange(12) / 24)
    assert "frames per second" not in notes(take)


@pytest.mark.parametrize("title", ["frame", "take"])
def test_a_given_rate_counts_for_rows_and_frames_without_times(read, title):
    take = read(range(60), title, 23.976)
    np.testing.assert_allclose(take.times, np.arange(60) / 23.976)
    assert not notes(take)


@pytest.mark.parametrize(("fps", "counted"), [(29.97, 30), (23.976, 24), (59.94, 60), (30.0, 30), (100.0, 100)])
@pytest.mark.parametrize("count", [20, 250])
def test_a_given_rate_is_that_of_frames_in_timecodes(read, fps, counted, count):
    np.testing.assert_allclose(np.diff(read(stamps(count, counted), fps=fps).times), 1 / fps, atol=1e-6)


@pytest.mark.parametrize("fps", [25.0, 59.94])
def test_a_rate_that_the_timecodes_contradict_is_refused(read, fps):
    with pytest.raises(SourceError, match=f"count 30 frames per second, not {fps:g}"):
        read(stamps(90, 30), fps=fps)


def test_a_title_may_state_the_rate_of_its_timecodes(read):
    np.testing.assert_allclose(np.diff(read(stamps(20, 24), "Timecode (23.976 fps)").times), 1 / 23.976, atol=1e-6)


@pytest.mark.parametrize("title", ["time", "frame_time"])
def test_a_rate_for_times_of_its_own_is_said_to_be_unused(read, title):
    take = read([i / 25 for i in range(20)], title, 60.0)
    np.testing.assert_allclose(np.diff(take.times), 0.04)
    assert "60 frames per second was not used" in notes(take)


def test_the_command_passes_the_rate_on_and_refuses_an_impossible_one(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("\n".join(table_lines(range(20), "frame")))
    command = ["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "a.facetake"), "--fps"]
    assert main([*command, "50"]) == 0
    np.testing.assert_allclose(np.diff(load_take(tmp_path / "a.facetake").times), 0.02)
    assert main([*command, "0.5"]) == 1 and "rate cannot be 0.5" in capsys.readouterr().err
    (tmp_path / "b.blend").write_bytes(b"")
    assert main(["import", str(tmp_path / "b.blend"), "-o", str(tmp_path / "a.facetake"), "--fps", "50"]) == 1
    assert "Leave out --fps" in capsys.readouterr().err


@pytest.mark.parametrize("rate", [24, 25, 30, 60])
def test_decimals_that_are_milliseconds_of_the_second_are_the_times(read, rate):
    times = np.arange(3 * rate) / rate
    whole = [(int(t), int(1000 * (t - int(t)) + 1e-6)) for t in times.tolist()]
    take = read([f"00:00:{second:02d}:{ms * rate // 1000:02d}.{ms:03d}" for second, ms in whole])
    np.testing.assert_allclose(take.times, times, atol=1e-6)


def test_the_timecode_that_is_wrong_is_named_with_its_row(read):
    texts = stamps(30)
    texts[11] = "10:2x:00:11.000"
    with pytest.raises(SourceError, match=re.escape("row 12 has '10:2x:00:11.000'")):
        read(texts)
