"""The file of a take is exact and small, and everything intact in it is read."""

from __future__ import annotations

import os
import re
import signal
import struct
import subprocess
import sys
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import facemime
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.errors import OutputError, SourceError
from facemime.core.face.landmarks import OUTER_EYE_CORNERS
from facemime.core.face.names import N_ACTIONS
from facemime.core.heads.rig import built_in_head
from facemime.core.takes import format as layout
from facemime.core.takes.file import TakeWriter, load_take, save_take, take_of
from facemime.core.takes.format import HEADER, LAYOUT, MARKER, chunk_bytes, chunks_in, frames_content, info_content
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import FIELDS, Take
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.takes import performance

CLIP = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


@pytest.fixture(scope="module")
def tracked(tmp_path_factory) -> tuple[Take, Path]:
    """The first four seconds of the sample clip: the take in memory, and its file written while tracking."""
    path = tmp_path_factory.mktemp("take") / "sample.facetake"
    return track_video(CLIP, FaceTracker.load(), lambda done, *_: done < 100, path), path


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> bytes:
    """The file of a take of 60 frames at 25 per second, one of them lost: three chunks of frames."""
    path = tmp_path_factory.mktemp("take") / "take.facetake"
    save_take(performance(), path)
    return path.read_bytes()


def same_rows(part: Take, whole: Take) -> bool:
    """Whether every frame of `part` equals the frame of `whole` at that time, bit by bit."""
    rows = np.searchsorted(whole.times, part.times)
    return all(np.array_equal(getattr(part, f), getattr(whole, f)[rows], equal_nan=f != "found") for f in FIELDS)


def starts(data: bytes) -> list[int]:
    """Return where the chunks of an intact file begin."""
    places = [0]
    for chunk in chunks_in(data):
        places.append(places[-1] + HEADER.size + len(chunk.content))
    return places[:-1]


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


@pytest.mark.thorough
def test_a_take_truncated_at_any_byte_keeps_all_earlier_seconds_and_reports_the_rest(written):
    whole = take_of(written)
    *_, last, end = starts(written)
    for cut in range(last, end + 1):
        part = take_of(written[:cut])
        assert len(part) == (52 if cut < end else 60) and same_rows(part, whole)
        assert f"Missing: up to a second after {part.times[-1]:.2f} s." in part.info["recovered"]
    assert "recovered" not in whole.info


def test_frames_before_and_after_a_damaged_second_are_kept(written):
    first, second = starts(written)[1:3]
    for at in (first, first + 12, first + HEADER.size + 5, second - 1):
        broken = bytearray(written)
        broken[at] ^= 0x10
        part = take_of(bytes(broken))
        assert same_rows(part, take_of(written)) and len(part) == 34
        assert part.info["recovered"].endswith("Missing: 26 frames before 1.04 s.")
        assert part.info["source"] == "performance.mp4"
    part = take_of(written[:first] + written[first + 7 : second] + written[second:])
    assert len(part) == 34


def test_a_missing_second_is_reported_with_its_times(written):
    _, _, second, third, *_ = starts(written)
    part = take_of(written[:second] + written[third:])
    assert part.info["recovered"].endswith("Missing: 26 frames between 1.00 s and 2.08 s.")
    twice = take_of(written[:third] + written[second:])
    assert same_rows(twice, take_of(written)) and len(twice) == 60


def test_frames_are_read_without_the_description(written):
    _, first, *_, end = starts(written)
    part = take_of(written[first:end])
    assert len(part) == 60 and "the description" in part.info["recovered"]


@settings(max_examples=150)
@given(st.lists(st.tuples(st.integers(0, 10**9), st.integers(1, 255)), min_size=1, max_size=8))
def test_flipped_bits_never_change_a_number_that_is_read(written, flips):
    whole, broken = take_of(written), bytearray(written)
    for at, mask in flips:
        broken[at % len(broken)] ^= mask
    try:
        part = take_of(bytes(broken))
    except ValueError:
        return
    assert same_rows(part, whole)
    assert len(part) == len(whole) or "recovered" in part.info


@settings(max_examples=100)
@given(st.binary(max_size=300), st.integers(0, 5))
def test_other_files_are_refused_with_a_clear_message(tmp_path_factory, data, markers):
    path = tmp_path_factory.getbasetemp() / "any.facetake"
    path.write_bytes(MARKER * markers + data)
    with pytest.raises(SourceError, match="is not a Facemime take"):
        load_take(path)


def test_missing_empty_and_newer_files_are_refused_with_clear_messages(written, tmp_path, monkeypatch):
    with pytest.raises(SourceError, match="There is no take"):
        load_take(tmp_path / "none.facetake")
    (tmp_path / "empty.facetake").write_bytes(b"")
    with pytest.raises(SourceError, match="no frame in it can be read"):
        load_take(tmp_path / "empty.facetake")
    with monkeypatch.context() as patch:
        patch.setattr(layout, "FORMAT_VERSION", layout.FORMAT_VERSION + 1)
        save_take(performance(), tmp_path / "new.facetake")
    with pytest.raises(SourceError, match="newer Facemime"):
        load_take(tmp_path / "new.facetake")


def test_a_take_of_the_first_format_opens_without_actions_and_keeps_everything_else():
    take = load_take(Path(__file__).parents[2] / "data" / "before_floors" / "take.facetake")
    assert np.isnan(take.actions).all() and np.isnan(take.vergence).all()
    assert take.actions.shape == (len(take), N_ACTIONS)
    assert np.isfinite(take.shape[take.found]).all()
    again = layout.frames_of(frames_content(take), len(take))
    np.testing.assert_array_equal(again.shape, take.shape)


def hostile_header(length: int) -> bytes:
    """A header with a correct checksum that states `length` bytes of content with a wrong checksum."""
    head = HEADER.pack(MARKER, 1, b"F", 1, 0, length, 1, 0)[:-4]
    return head + struct.pack("<I", zlib.crc32(head))


def test_counts_stated_in_a_file_allocate_no_memory(written):
    first = take_of(written).part(slice(0, 1))
    bomb = frames_content(first)[:8] + zlib.compress(bytes(40_000_000))
    hostile = hostile_header(2**32 - 1) + chunk_bytes(b"F", bomb, count=1) + chunk_bytes(b"F", b"", count=0)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="no frame"):
            take_of(hostile)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()
    assert len(take_of(hostile + written)) == 60


def test_nested_headers_are_refused():
    with pytest.raises(ValueError, match="overlap"):
        take_of(hostile_header(4_000_000) * 100 + bytes(4_100_000))


def test_invalid_content_with_a_valid_checksum_is_skipped(written):
    first = starts(written)[1]
    nonsense = chunk_bytes(b"S", b"[]") + chunk_bytes(b"S", b"\xff") + chunk_bytes(b"F", b"nothing", count=3)
    nonsense += chunk_bytes(b"S", b"[" * 100_000)
    take = take_of(written[:first] + nonsense + written[first:])
    assert len(take) == 60 and "recovered" not in take.info


@pytest.mark.parametrize("size", [-1, 0, 0.5, 10**6, "480"])
def test_impossible_entries_of_the_description_are_dropped(written, size):
    wrong = {"fps": "fast", "image_size": [640, size], "calibration": 3, "bridged": {}, "source": "x", "my own": [1]}
    end = starts(written)[-1]
    take = take_of(written[:end] + chunk_bytes(b"E", info_content(wrong, 60)))
    assert take.info == {"source": "x", "my own": [1]}


def test_chunks_with_decreasing_times_are_skipped(written):
    first, rest = take_of(written).part(slice(0, 10)), take_of(written).part(slice(5, 9))
    data = chunk_bytes(b"S", info_content({}, 0)) + chunk_bytes(b"F", frames_content(first), count=10)
    take = take_of(data + chunk_bytes(b"F", frames_content(rest), count=4, first=10))
    np.testing.assert_array_equal(take.times, first.times)


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


def packed_frames(times: np.ndarray, modes: int) -> bytes:
    """Frames that unpack to the largest size: all zeros."""
    columns = int(sum(np.prod(shape) for _, shape, _ in LAYOUT[:-1])) + modes
    return times.astype("<f8").tobytes() + zlib.compress(bytes(4 * len(times) * columns), 9)


@pytest.mark.thorough
def test_a_small_file_that_unpacks_to_gigabytes_is_refused_within_bounds(tmp_path):
    out, first = chunk_bytes(layout.START, info_content({}, 0)), 0
    content = packed_frames(np.arange(256), 512)
    while len(out) < 600_000:
        times = (np.arange(256) + first).astype("<f8").tobytes()
        out += chunk_bytes(layout.FRAMES, times + content[len(times) :], count=256, first=first)
        first += 256
    path = tmp_path / "bomb.facetake"
    path.write_bytes(out)
    tracemalloc.start()
    with pytest.raises(SourceError, match="unpacks to more than"):
        load_take(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200 * len(out) + (48 << 20)


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


def test_frames_of_another_model_count_as_damage(written):
    *_, end = starts(written)
    content = packed_frames(np.array([90.0]), 7)
    part = take_of(written[:end] + chunk_bytes(layout.FRAMES, content, count=1, first=60) + written[end:])
    assert len(part) == 60 and part.shape_params.shape[1] == 2


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("offset", "soon"),
        ("offset", 1e300),
        ("offset", None),
        ("bridged", [1, 2]),
        ("bridged", [[0.0, "x"]]),
        ("punched_in", {}),
        ("source", ["a"]),
        ("model", 3),
        ("sound", {}),
    ],
)
def test_entries_of_the_wrong_type_are_dropped(written, key, value):
    end = starts(written)[-1]
    info = {"fps": 25.0, key: value}
    told = take_of(written[:end] + chunk_bytes(layout.END, info_content(info, 60))).info
    assert told == {"fps": 25.0}


def test_an_infinite_number_in_the_description_is_damage(written):
    end = starts(written)[-1]
    content = b'{"info": {"fps": 25.0, "offset": ' + b"9" * 400 + b'}, "frames": 60}'
    assert take_of(written[:end] + chunk_bytes(layout.END, content)).info["source"] == "performance.mp4"


def test_a_source_whose_name_is_not_utf_8_is_kept(written, tmp_path):
    """Linux gives file names in another encoding this form."""
    save_take(replace(take_of(written), info={"source": "caf\udce9.mp4"}), tmp_path / "odd.facetake")
    assert load_take(tmp_path / "odd.facetake").info == {"source": "caf\udce9.mp4"}
