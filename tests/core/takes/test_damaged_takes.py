"""Everything intact in a damaged take is read, and files made to do harm are refused."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.errors import SourceError
from facemime.core.takes import format as layout
from facemime.core.takes.file import load_take, save_take, take_of
from facemime.core.takes.format import HEADER, LAYOUT, MARKER, chunk_bytes, frames_content, info_content
from tests.helpers.takes import performance, same_rows, starts


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
