"""The file of a take is exact and small, and loses nothing of a recording."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import facemime
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.errors import OutputError
from facemime.core.face.landmarks import OUTER_EYE_CORNERS
from facemime.core.face.names import N_ACTIONS
from facemime.core.heads.rig import built_in_head
from facemime.core.takes import format as layout
from facemime.core.takes.file import TakeWriter, load_take, save_take, take_of
from facemime.core.takes.format import LAYOUT, frames_content
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import FIELDS, Take
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.takes import performance, starts

CLIP = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


@pytest.fixture(scope="module")
def tracked(tmp_path_factory) -> tuple[Take, Path]:
    """The first four seconds of the sample clip: the take in memory, and its file written while tracking."""
    path = tmp_path_factory.mktemp("take") / "sample.facetake"
    return track_video(CLIP, FaceTracker.load(), lambda done, *_: done < 100, path), path


def test_loaded_values_differ_by_at_most_half_a_step(tracked):
    take, path = tracked
    loaded = load_take(path)
    np.testing.assert_array_equal(loaded.times, take.times)
    for name, _, step in LAYOUT:
        was, now = (np.asarray(getattr(t, name), float) for t in (take, loaded))
        np.testing.assert_array_equal(np.isnan(now), np.isnan(was))
        assert (np.nan_to_num(np.abs(now - was)) <= 0.5000001 * np.asarray(step)).all(), name
        assert getattr(loaded, name).dtype == getattr(take, name).dtype
    assert loaded.info == take.info and loaded.info["clock"] == "media"


def test_the_head_driven_by_the_loaded_take_differs_by_less_than_a_thousandth_of_the_eye_distance(tracked):
    take, path = tracked
    rig = built_in_head()
    driver = HeadDriver(rig, calibrate(take))
    was, now = (drive_take(driver, t).vertices for t in (take, load_take(path)))
    unit = np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[OUTER_EYE_CORNERS]].astype(float)))
    assert np.linalg.norm(now - was, axis=-1).max() < 0.001 * unit


def test_a_minute_at_30_frames_per_second_is_smaller_than_a_megabyte(tracked):
    take, path = tracked
    assert path.stat().st_size / len(take) * 1800 < 1e6


def test_saving_a_loaded_take_gives_the_same_file(tracked, tmp_path):
    save_take(load_take(tracked[1]), tmp_path / "a.facetake")
    save_take(load_take(tmp_path / "a.facetake"), tmp_path / "b.facetake")
    assert (tmp_path / "a.facetake").read_bytes() == (tmp_path / "b.facetake").read_bytes()


def test_frames_are_read_without_the_description(written):
    _, first, *_, end = starts(written)
    part = take_of(written[first:end])
    assert len(part) == 60 and "the description" in part.info["recovered"]


def test_a_take_of_the_first_format_opens_without_actions_and_keeps_everything_else():
    take = load_take(Path(__file__).parents[2] / "data" / "before_floors" / "take.facetake")
    assert np.isnan(take.actions).all() and np.isnan(take.vergence).all() and np.isnan(take.teeth).all()
    assert take.actions.shape == (len(take), N_ACTIONS)
    assert np.isfinite(take.shape[take.found]).all()
    again = layout.frames_of(frames_content(take), len(take))
    np.testing.assert_array_equal(again.shape, take.shape)


def test_a_face_with_nan_is_written_as_lost(tmp_path):
    take = performance()
    take.shape[3, 5] = np.nan
    save_take(take, tmp_path / "take.facetake")
    assert np.flatnonzero(~load_take(tmp_path / "take.facetake").found).tolist() == [3, 30]


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(1e-3, 1e30))
def test_numbers_of_any_size_are_kept_or_clipped(seed, size):
    take = performance(8)
    wild = np.random.default_rng(seed).normal(scale=size, size=take.shape.shape).astype(np.float32)
    now = layout.frames_of(frames_content(replace(take, shape=wild)), 8).shape
    limit = 2.0**18
    np.testing.assert_allclose(now[take.found], np.clip(wild, -limit, limit)[take.found], rtol=1e-6, atol=2.0**-14)


def test_a_killed_recording_loses_at_most_its_last_second(tmp_path):
    path = tmp_path / "take.facetake"
    script = (
        "import sys; from pathlib import Path; from facemime.core.takes.file import TakeWriter\n"
        "from tests.helpers.takes import performance\n"
        "take = performance(500); writer = TakeWriter(Path(sys.argv[1]), take.info)\n"
        "for i in range(500):\n"
        "    writer.append(float(take.times[i]), take.result(i)); print(i, flush=True)\n"
        "    if i == 110: sys.stdin.read()\n"
    )
    arguments = [sys.executable, "-c", script, str(path)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as process:
        while process.stdout.readline().strip() != b"110":
            assert process.poll() is None
        process.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
    take = load_take(path)
    assert take.times[-1] > 110 / 25.0 - 1.0
    assert "up to a second after" in take.info["recovered"] and take.info["source"] == "performance.mp4"


def test_a_full_disk_is_reported_and_loses_nothing(tmp_path):
    resource = pytest.importorskip("resource")
    take, path = performance(), tmp_path / "take.facetake"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = TakeWriter(path, take.info)
    try:
        with pytest.raises(OutputError, match=r"The first 26 frames are safe. Free some space"):
            for frame, time in enumerate(take.times.tolist()):
                writer.append(time, take.result(frame))
                if frame == 30:
                    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 100, hard))
        with pytest.raises(OutputError):
            writer.flush()
        assert len(load_take(path)) == 26
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    for late in range(frame + 1, 60):
        writer.append(float(take.times[late]), take.result(late))
    writer.close()
    assert len(load_take(path)) == 60 and "recovered" not in load_take(path).info


def test_a_recording_never_replaces_a_file_and_leaves_none_without_a_frame(tmp_path):
    path = tmp_path / "new" / "take.facetake"
    with TakeWriter(path, {}):
        assert path.exists()
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(OutputError, match="file exists"):
        TakeWriter(path, {})
    assert path.read_text() == "mine"


def test_the_last_description_is_read(tmp_path):
    take = performance()
    with TakeWriter(tmp_path / "take.facetake", {"source": "a", "gaze": np.array([np.nan, 1.0])}) as writer:
        for frame, time in enumerate(take.times.tolist()):
            writer.append(time, take.result(frame))
            assert len(writer) == frame + 1
        with pytest.raises(ValueError, match="must increase"):
            writer.append(1.0, take.result(0))
        writer.info["interrupted"] = True
    writer.close()
    assert load_take(tmp_path / "take.facetake").info == {"source": "a", "gaze": [None, 1.0], "interrupted": True}


def test_the_documented_reader_agrees_with_facemime_and_needs_only_numpy(written, tmp_path):
    document = (Path(facemime.__file__).parent / "docs" / "guides" / "takes.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", document, flags=re.DOTALL)
    assert set(re.findall(r"\b(?:import|from) (.+)", code)) == {"json, struct, sys, zlib", "numpy as np"}
    (tmp_path / "take.facetake").write_bytes(written)
    out = tmp_path / "out.npz"
    code += f"\nnp.savez({str(out)!r}, times=times, source=info['source'], **take)"
    subprocess.run([sys.executable, "-I", "-c", code, str(tmp_path / "take.facetake")], check=True)
    expected = take_of(written)
    with np.load(out) as read:
        assert read["source"] == "performance.mp4"
        for name in FIELDS:
            values = getattr(expected, name)
            np.testing.assert_array_equal(read[name], values.reshape(read[name].shape))


def test_the_documented_columns_and_steps_are_those_of_the_format():
    document = (Path(facemime.__file__).parent / "docs" / "guides" / "takes.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^columns = .*?\n(?=times)", document, flags=re.DOTALL | re.MULTILINE)
    stated: dict = {}
    exec(code, stated)
    assert list(stated["columns"]) == [name for name, _, _ in LAYOUT]
    np.testing.assert_array_equal(stated["steps"], layout._steps(LAYOUT, 0)[: len(stated["steps"])])
    assert (layout._steps(LAYOUT, 9)[len(stated["steps"]) :] == 2.0**-13).all()


@pytest.mark.thorough
def test_a_take_without_any_face_is_read(tmp_path):
    """A take without a face compresses thirty times better than one with a face."""
    with TakeWriter(tmp_path / "empty.facetake", {}, sync=False) as writer:
        for frame in range(40_000):
            writer.append(frame / 30.0, TrackResult.nothing(48))
    assert len(load_take(tmp_path / "empty.facetake")) == 40_000


def test_reading_needs_at_most_half_as_much_memory_again_as_the_take(written, tmp_path):
    take = take_of(written)
    times = np.arange(20 * len(take)) / 25.0
    long = replace(take.part(np.tile(np.arange(len(take)), 20)), times=times)
    save_take(long, tmp_path / "long.facetake")
    tracemalloc.start()
    loaded = load_take(tmp_path / "long.facetake")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.6 * sum(getattr(loaded, name).nbytes for name in FIELDS) + (2 << 20)


def test_a_source_whose_name_is_not_utf_8_is_kept(written, tmp_path):
    """Linux gives file names in another encoding this form."""
    save_take(replace(take_of(written), info={"source": "caf\udce9.mp4"}), tmp_path / "odd.facetake")
    assert load_take(tmp_path / "odd.facetake").info == {"source": "caf\udce9.mp4"}
