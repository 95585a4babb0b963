"""Pins on the command line: added by mend, learnt from, and exported."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.cli import main as cli
from facemime.core.face.landmarks import BROWS, IBUG68_INDICES
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.pins import Pin, learns_from_pins, pins_of, read_pins, with_pins, write_pins
from facemime.core.takes.spreadsheet import from_csv
from facemime.core.takes.take import FIELDS, Take
from tests.helpers.takes import performance

RIGHT = BROWS[:5]


def raised(take: Take, frames=(3, 10, 20), up: float = 4.0) -> list[Pin]:
    """Pins of the right brow, higher by pixels than it was tracked."""
    return [
        Pin(
            float(take.times[frame]),
            int(n),
            float(take.landmarks[frame, n, 0]),
            float(take.landmarks[frame, n, 1]) - up,
        )
        for frame in frames
        for n in RIGHT
    ]


@pytest.fixture
def paths(tmp_path):
    """Files: a take, the same take with pins, and a table of these pins."""
    plain, pinned, table = tmp_path / "take.facetake", tmp_path / "pinned.facetake", tmp_path / "pins.csv"
    save_take(performance(), plain)
    take = load_take(plain)
    save_take(with_pins(take, raised(take)), pinned)
    write_pins(raised(take), table)
    return plain, pinned, table


def run(*arguments) -> int:
    return cli.main([str(argument) for argument in arguments])


def height(take: Take) -> np.ndarray:
    """Height of the right brow in each frame, in pixels."""
    return -take.landmarks[:, RIGHT, 1].mean(axis=1)


@pytest.mark.parametrize("source", ["table", "take"])
def test_mend_adds_pins_that_stay_removable(paths, tmp_path, source):
    plain, pinned, table = paths
    out = tmp_path / "out.facetake"
    assert run("mend", plain, "-o", out, "--pins", table if source == "table" else pinned) == 0
    before, unsolved = load_take(plain), load_take(out, solved=False)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(unsolved, name), getattr(before, name))
    assert len(pins_of(unsolved)) == 15
    assert (height(load_take(out)) - height(before))[10] == pytest.approx(4.0, abs=0.3)


def test_mend_adds_to_the_pins_of_the_take_and_keeps_them_otherwise(paths, tmp_path):
    plain, pinned, table = paths
    write_pins(raised(load_take(plain), (40,)), table)
    assert run("mend", pinned, "-o", tmp_path / "out.facetake", "--pins", table, "--smooth", "zero-phase") == 0
    out = load_take(tmp_path / "out.facetake")
    assert len(pins_of(out)) == 20
    assert (height(out) - height(load_take(plain)))[[10, 40]] == pytest.approx([4.0, 4.0], abs=0.3)


def test_mend_learns_from_pins_in_other_frames(paths, tmp_path):
    plain, _, table = paths
    run("mend", plain, "-o", tmp_path / "out.facetake", "--pins", table, "--learn")
    out = load_take(tmp_path / "out.facetake")
    assert learns_from_pins(out)
    assert (height(out) - height(load_take(plain)))[24] > 3.0


def test_mend_learns_from_the_pins_of_another_take(paths, tmp_path):
    plain, pinned, _ = paths
    assert run("mend", plain, "-o", tmp_path / "out.facetake", "--learn-from", pinned) == 0
    out = load_take(tmp_path / "out.facetake", solved=False)
    assert pins_of(out) == ()
    assert (height(out) - height(load_take(plain)))[24] > 3.0


def test_the_figure_shows_the_effect_of_pins(paths, tmp_path):
    plain, _, table = paths
    run("mend", plain, "-o", tmp_path / "a.facetake", "--figure", tmp_path / "a.png")
    run("mend", plain, "-o", tmp_path / "b.facetake", "--pins", table, "--figure", tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() != (tmp_path / "b.png").read_bytes()


def test_an_anonymous_take_has_no_pins_and_shows_what_they_corrected(paths, tmp_path):
    plain, pinned, _ = paths
    run("mend", plain, "-o", tmp_path / "a.facetake", "--anonymous")
    run("mend", pinned, "-o", tmp_path / "b.facetake", "--anonymous")
    a, b = load_take(tmp_path / "a.facetake"), load_take(tmp_path / "b.facetake")
    assert pins_of(b) == ()
    assert (height(b) - height(a))[10] > 1.0


def test_export_writes_the_table_that_mend_reads(paths, tmp_path):
    plain, pinned, _ = paths
    run("export", pinned, "-o", tmp_path / "out.csv", "--columns", "pins")
    assert read_pins(tmp_path / "out.csv") == pins_of(load_take(pinned))
    assert (tmp_path / "out.csv").read_text().splitlines()[1].split(",")[1] == str(IBUG68_INDICES[RIGHT[0]])
    run("export", plain, "-o", tmp_path / "none.csv", "--columns", "pins")
    assert (tmp_path / "none.csv").read_text() == "time,landmark,x,y\n"


def test_a_table_of_a_take_contains_the_corrected_landmarks_without_pins(paths, tmp_path):
    _, pinned, _ = paths
    run("export", pinned, "-o", tmp_path / "out.csv")
    table = from_csv(tmp_path / "out.csv")
    assert pins_of(table) == ()
    np.testing.assert_array_equal(table.landmarks, load_take(pinned).landmarks)


@pytest.mark.parametrize(
    "options, problem",
    [
        (["--learn"], "Add --pins"),
        (["--learn-from", "{plain}"], "tell nothing"),
        (["--pins", "{plain}"], "no pins in"),
        (["--pins", "{empty}"], "no pins in"),
        (["--pins", "missing.csv"], "no table"),
    ],
)
def test_pins_that_do_nothing_are_one_clear_error(paths, tmp_path, capsys, options, problem):
    plain = paths[0]
    write_pins([], tmp_path / "empty.csv")
    names = {"plain": plain, "empty": tmp_path / "empty.csv", "out": tmp_path / "out.facetake"}
    options = [option.format(**names) for option in options]
    assert run("mend", plain, "-o", tmp_path / "out.facetake", *options) != 0
    error = capsys.readouterr().err
    assert problem in error and "Traceback" not in error
    assert not (tmp_path / "out.facetake").exists()
