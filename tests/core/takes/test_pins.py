"""Pins stay in their places whatever is done to a take, and no file with damaged pins fails to open."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.drive.retarget import anonymise
from facemime.core.errors import SourceError
from facemime.core.face.landmarks import JAW, LIPS, N_LANDMARKS
from facemime.core.takes.file import append_pins, load_take, pins_content, save_take
from facemime.core.takes.mending import mirror_take
from facemime.core.takes.pins import (
    MAX_PINS,
    PINS,
    Pin,
    frames_of_pins,
    pins_of,
    read_pins,
    with_pins,
    write_pins,
)
from facemime.core.takes.take import FIELDS, Take
from facemime.core.takes.timing import mark_lost, punch_in, resample, shift_time, trim
from tests.helpers.takes import performance as unsaved

FRAME = 40


@cache
def recorded(count: int) -> Take:
    """A take as read from a file, which rounds."""
    with TemporaryDirectory() as folder:
        save_take(unsaved(count), Path(folder) / "take.facetake")
        return load_take(Path(folder) / "take.facetake")


def performance(count: int = 60) -> Take:
    """A copy of that take."""
    return recorded(count).part(slice(None))


def pinned(take: Take, frame: int = FRAME, landmark: int = 10, by: tuple[float, float] = (4.0, -3.0)) -> Take:
    """A take with one more pin, displaced from the tracked landmark by pixels."""
    x, y = (take.landmarks[frame, landmark] + by).astype(float).tolist()
    return with_pins(take, [*pins_of(take), Pin(float(take.times[frame]), landmark, x, y)])


def saved(take: Take, tmp_path) -> Take:
    """What is read of the file of a take."""
    save_take(take, tmp_path / "saved.facetake")
    return load_take(tmp_path / "saved.facetake")


def off(take: Take, solved: Take) -> float:
    """Largest distance in pixels of solved landmarks from the pins of a take."""
    pins = pins_of(take)
    rows, shown = frames_of_pins(solved, np.array([pin.time for pin in pins]))
    assert shown.all()
    at = solved.landmarks[np.flatnonzero(solved.found)[rows], [pin.landmark for pin in pins]]
    return float(np.abs(at - [(pin.x, pin.y) for pin in pins]).max())


def test_a_pin_is_where_it_was_put_after_saving_and_stays_removable(tmp_path):
    take = pinned(performance())
    assert off(take, saved(take, tmp_path)) < 0.2
    unsolved = load_take(tmp_path / "saved.facetake", solved=False)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(unsolved, name), getattr(take, name))
    assert pins_of(unsolved) == pins_of(take)
    save_take(with_pins(unsolved, []), tmp_path / "without.facetake")
    np.testing.assert_array_equal(load_take(tmp_path / "without.facetake").shape, take.shape)


@pytest.mark.parametrize(
    "change",
    [
        lambda take: shift_time(take, 3.7),
        lambda take: trim(take, 1.2, 2.0),
        mirror_take,
        lambda take: punch_in(take, performance(80), 0.2, 0.6),
        lambda take: punch_in(performance(80), take, 1.2, 2.2, 0.1),
        lambda take: resample(take, 50.0),
        lambda take: resample(take, 10.0),
    ],
    ids=["shift", "trim", "mirror", "punch in", "punch in with pins", "resample", "resample to fewer"],
)
def test_pins_stay_in_place_when_a_take_changes(change, tmp_path):
    changed = change(pinned(pinned(performance()), landmark=50))
    assert len(pins_of(changed)) == 2
    assert off(changed, saved(changed, tmp_path)) < 0.2


def test_an_anonymous_take_is_solved_and_has_no_pins():
    take = pinned(performance(), by=(0.0, 8.0))
    hidden = anonymise(take)
    assert PINS not in hidden.info
    assert np.abs(hidden.shape - anonymise(performance()).shape)[FRAME].max() > 0.02


def test_of_pins_for_one_landmark_at_one_time_the_last_stays():
    take = with_pins(performance(), [Pin(1.0, 3, 1.0, 2.0), Pin(1.0, 3, 5.0, 6.0)])
    assert pins_of(take) == (Pin(1.0, 3, 5.0, 6.0),)


def test_too_many_pins_are_an_error():
    with pytest.raises(SourceError, match="2049 pins"):
        with_pins(performance(), [Pin(float(i), 0, 0.0, 0.0) for i in range(MAX_PINS + 1)])


@pytest.mark.parametrize(
    "listed",
    [
        None,
        "abcd",
        {"a": 1},
        [None, 1, "abcd", [1.0], [1.0, 2, 3.0], [1.0, 2, 3.0, "4"]],
        [[1.6, 10, float("nan"), 0.0], [float("inf"), 10, 0.0, 0.0], [1.6, 10, 10**400, 0.0]],
        [[1.6, 66, 0.0, 0.0], [1.6, -1, 0.0, 0.0], [1.6, 10.5, 0.0, 0.0], [True, True, True, True]],
        [[1.6, 10, 1e300, 0.0], [1.6, 10, 50_000.0, 0.0]],
    ],
    ids=["none", "text", "object", "no pins", "not finite", "not a landmark", "far away"],
)
def test_damaged_pins_are_ignored(listed, tmp_path):
    take = performance()
    read = saved(replace(take, info={**take.info, PINS: listed}), tmp_path)
    np.testing.assert_array_equal(read.shape, take.shape)
    np.testing.assert_array_equal(read.landmarks, take.landmarks)


def test_of_too_many_pins_in_a_file_the_first_are_used():
    take = performance()
    rows = [[float(i), 0, 0.0, 0.0] for i in range(3 * MAX_PINS)]
    assert len(pins_of(replace(take, info={**take.info, PINS: rows}))) == MAX_PINS


def test_a_pin_where_there_is_no_face_or_frame_changes_nothing_and_is_kept(tmp_path):
    take = mark_lost(performance(), np.arange(60) // 10 == 3)
    where = [float(take.times[35]), -5.0, 100.0]
    take = with_pins(take, [Pin(time, 10, 300.0, 300.0) for time in where])
    read = saved(take, tmp_path)
    np.testing.assert_array_equal(read.shape, take.shape)
    assert len(pins_of(read)) == 3
    nobody = with_pins(mark_lost(performance(), np.ones(60, bool)), pins_of(take))
    assert len(pins_of(saved(nobody, tmp_path))) == 3


def test_the_frame_of_a_pin_is_the_nearest_one():
    take = performance()
    times = np.array([0.0, 0.019, 0.021, 2.36, -0.02, -0.03, 2.38, 2.39])
    rows, shown = frames_of_pins(take, times)
    assert np.flatnonzero(take.found)[rows].tolist() == [0, 0, 1, 59, 0, 0, 59, 59]
    assert shown.tolist() == [True, True, True, True, True, False, True, False]


def test_appended_pins_change_no_earlier_byte(tmp_path):
    path = tmp_path / "take.facetake"
    save_take(performance(), path)
    before = path.read_bytes()
    append_pins(pinned(load_take(path, solved=False)), path)
    once = path.read_bytes()
    assert once.startswith(before)
    assert len(pins_of(load_take(path))) == 1
    append_pins(with_pins(load_take(path, solved=False), []), path)
    assert path.read_bytes().startswith(once)
    assert pins_of(load_take(path)) == ()
    np.testing.assert_array_equal(load_take(path).shape, performance().shape)


def test_a_torn_append_loses_nothing_of_the_take(tmp_path):
    path = tmp_path / "take.facetake"
    first = pinned(performance())
    save_take(first, path)
    whole, added = path.read_bytes(), pins_content(pinned(first, frame=50))
    for kept in (1, 9, len(added) // 2, len(added) - 1):
        path.write_bytes(whole + added[:kept])
        read = load_take(path, solved=False)
        assert pins_of(read) == pins_of(first)
        np.testing.assert_array_equal(read.shape, first.shape)
        # What is appended after the torn part is found.
        append_pins(pinned(read, frame=55), path)
        assert len(pins_of(load_take(path))) == 2


def test_an_earlier_version_sees_what_was_tracked(tmp_path):
    path = tmp_path / "take.facetake"
    save_take(pinned(performance()), path)
    ignoring = load_take(path, solved=False)
    np.testing.assert_array_equal(ignoring.landmarks, performance().landmarks)
    assert "recovered" not in ignoring.info


@settings(max_examples=30)
@given(
    st.lists(
        st.builds(
            Pin,
            st.floats(-1e3, 1e5),
            st.integers(0, N_LANDMARKS - 1),
            st.floats(-1e4, 1e4),
            st.floats(-1e4, 1e4),
        ),
        max_size=20,
    )
)
def test_a_table_of_pins_is_read_back_exactly(tmp_path_factory, pins):
    path = tmp_path_factory.getbasetemp() / "pins.csv"
    write_pins(pins, path)
    assert read_pins(path) == tuple(pins)


def test_a_table_from_a_spreadsheet_is_read(tmp_path):
    path = tmp_path / "pins.csv"
    path.write_text("landmark;note;time;x;y\n37;lid;1,5;200,25;100\n", encoding="utf-16")
    assert read_pins(path) == (Pin(1.5, 37, 200.25, 100.0),)


@pytest.mark.parametrize(
    "text, problem",
    [
        ("time,landmark,x\n1,2,3\n", "no column 'y'"),
        ("time,landmark,x,y\n1,60,3,4\n", "60"),
        ("time,landmark,x,y\n1,2,three,4\n", "three"),
        ("time,landmark,x,y\n1,nan,3,4\n", "nan"),
        ("time,landmark,x,y\n1,2,inf,4\n", "inf"),
        ("time,landmark,x,y\n1,1e999,3,4\n", "1e999"),
        ("time,landmark,x,y\n1,2.5,3,4\n", "2.5"),
        ("\x00\x01", "pins"),
    ],
)
def test_a_faulty_table_of_pins_says_what_is_wrong(tmp_path, text, problem):
    path = tmp_path / "pins.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match="table of pins") as error:
        read_pins(path)
    assert problem in str(error.value)


def test_a_missing_table_of_pins_names_its_columns(tmp_path):
    with pytest.raises(SourceError, match="time, landmark, x, y"):
        read_pins(tmp_path / "none.csv")


def test_pins_survive_json_without_loss():
    take = pinned(performance())
    again = replace(take, info=json.loads(json.dumps(take.info)))
    assert pins_of(again) == pins_of(take)
    assert {pin.landmark for pin in pins_of(again)} <= {*JAW.tolist(), *LIPS.tolist()}
