"""Takes as tables, and the commands that work on takes."""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.cli import main as cli
from facemime.cli.takes import parse_cutoffs, parse_span
from facemime.core.errors import FacemimeError, SourceError
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.mending import bridge_gaps, mirror_take
from facemime.core.takes.smooth import CUTOFFS
from facemime.core.takes.spreadsheet import from_csv, to_csv
from facemime.core.takes.take import FIELDS, Take
from facemime.core.takes.timing import resample, trim
from tests.helpers.takes import performance


@pytest.fixture
def saved(tmp_path):
    """A take of 60 frames at 25 per second, one of them lost, and its file."""
    path = tmp_path / "take.facetake"
    save_take(performance(), path)
    return load_take(path), path


def equal(a: Take, b: Take) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@settings(max_examples=20)
@given(st.integers(0, 1000))
def test_a_table_is_read_back_exactly(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    take = performance(12)
    take = replace(
        take,
        gaze=rng.normal(size=(12, 2)).astype(np.float32),
        pose=take.pose + rng.normal(size=(12, 6)),
        shape_params=rng.normal(size=(12, 3)).astype(np.float32) * 1e-7,
        info={**take.info, "calibration": {"shape": [1.0, None]}},
    )
    path = tmp_path_factory.getbasetemp() / "take.csv"
    to_csv(take, path)
    equal(from_csv(path), take)
    assert from_csv(path).info == take.info


def test_a_foreign_table_needs_only_times_pose_and_shape(tmp_path):
    take = performance()
    to_csv(take, tmp_path / "all.csv")
    with open(tmp_path / "all.csv", newline="") as stream:
        _, head, *rows = csv.reader(stream)
    kept = [i for i, name in enumerate(head) if name == "time" or name in ("scale", "pitch", "yaw", "roll", "tx", "ty")]
    kept = [*[i for i, name in enumerate(head) if name.startswith("shape_")][::-1], *kept]
    with open(tmp_path / "few.csv", "w", newline="", encoding="utf-8-sig") as stream:
        table = csv.writer(stream)
        table.writerow([*(head[i] for i in kept), "my notes"])
        table.writerows([*(row[i] for i in kept), "hello"] for row in rows)
        table.writerow([])
    few = from_csv(tmp_path / "few.csv")
    np.testing.assert_array_equal(few.found, take.found)
    np.testing.assert_array_equal(few.shape, take.shape)
    assert np.isnan(few.gaze).all() and few.shape_params.shape == (60, 0) and few.confidence[0] == 1.0
    assert np.isfinite(few.landmarks[few.found]).all()
    save_take(few, tmp_path / "few.facetake")
    assert len(load_take(tmp_path / "few.facetake")) == 60


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "its columns are neither"),
        ("time,jawOpen\n0,1\n", "its columns are neither"),
        ("time,scale\n0,1\n", "no column 'pitch'"),
        ("\x00\x00", "cannot be read as a take"),
        ("# facemime take nonsense\ntime\n", "cannot be read as a take"),
    ],
)
def test_an_invalid_table_is_refused_with_its_problem(tmp_path, text, words):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(SourceError, match=words):
        from_csv(tmp_path / "bad.csv")
    with pytest.raises(SourceError, match="There is no table"):
        from_csv(tmp_path / "none.csv")


def test_a_cell_that_is_not_a_number_is_named_with_its_row(tmp_path):
    to_csv(performance(), tmp_path / "take.csv")
    lines = (tmp_path / "take.csv").read_text().splitlines(keepends=True)
    lines[4] = lines[4].replace("0.08", "soon", 1)
    (tmp_path / "take.csv").write_text("".join(lines))
    with pytest.raises(SourceError, match="row 3 has 'soon' for time"):
        from_csv(tmp_path / "take.csv")
    (tmp_path / "take.csv").write_text("".join(lines[:2]))
    with pytest.raises(SourceError, match="no rows"):
        from_csv(tmp_path / "take.csv")


def test_export_and_import_give_the_same_file_again(saved, tmp_path):
    path = saved[1]
    assert cli.main(["export", str(path), "-o", str(tmp_path / "take.csv")]) == 0
    assert cli.main(["import", str(tmp_path / "take.csv"), "-o", str(tmp_path / "again.facetake")]) == 0
    assert (tmp_path / "again.facetake").read_bytes() == path.read_bytes()


def test_mend_applies_the_functions_in_order(saved, tmp_path):
    take, path = saved
    out = tmp_path / "out.facetake"
    arguments = ["--bridge", "--mirror", "--trim", "0.4:2", "--rate", "30", "--figure", str(tmp_path / "curves.png")]
    assert cli.main(["mend", str(path), "-o", str(out), *arguments]) == 0
    expected = resample(trim(mirror_take(bridge_gaps(take)), 0.4, 2.0), 30.0)
    save_take(expected, tmp_path / "expected.facetake")
    equal(load_take(out), load_take(tmp_path / "expected.facetake"))
    picture = cv2.imread(str(tmp_path / "curves.png"))
    assert picture.shape == (110 * len(CUTOFFS), 1200, 3) and picture.std() > 5


@pytest.mark.parametrize(
    ("arguments", "check"),
    [
        (["--hold"], lambda take: take.found.all() and len(take.info["bridged"]) == 1),
        (["--hold", "--longest", "0.01"], lambda take: not take.found[30]),
        (["--outliers"], lambda take: take.found.sum() == 59),
        (["--smooth", "one-euro"], lambda take: take.info["smoothed"] == "one-euro"),
        (["--smooth", "zero-phase", "--cutoff", "mouth=2,right eye=3"], lambda t: t.info["smoothed"] == "zero-phase"),
        (["--smooth", "zero-phase", "--cutoff", "mouth=1e300,jaw=0.001"], lambda take: take.found.sum() == 59),
        (["--neutral", "0.5"], lambda take: abs(take.info["calibration"]["start"] - 0.4) < 0.03),
        (["--anonymous"], lambda take: "source" not in take.info and take.found.sum() == 59),
        (["--shift", "-0.5"], lambda take: take.times[0] == -0.5),
    ],
)
def test_each_option_of_mend_has_its_effect(saved, tmp_path, arguments, check):
    out = tmp_path / "out.facetake"
    assert cli.main(["mend", str(saved[1]), "-o", str(out), *arguments]) == 0
    assert check(load_take(out))


def test_a_part_is_punched_in_by_the_command(saved, tmp_path):
    out = tmp_path / "out.facetake"
    assert cli.main(["mend", str(saved[1]), "-o", str(out), "--punch-in", str(saved[1]), "--at", "0.4:0.8"]) == 0
    assert load_take(out).info["punched_in"] == [[0.4, 0.8]]


def test_every_command_and_argument_has_a_help_text():
    (commands,) = (action for action in cli._parser()._actions if isinstance(action, argparse._SubParsersAction))
    assert len(commands.choices) == 13
    for name, parser in commands.choices.items():
        assert parser.description and parser.description.endswith("."), name
        assert all(action.help for action in parser._actions), name
        assert parser.format_help().startswith(f"usage: facemime {name}")


def test_a_blend_below_0_is_refused(saved, tmp_path, capsys):
    out, path = tmp_path / "out.facetake", str(saved[1])
    assert cli.main(["mend", path, "-o", str(out), "--punch-in", path, "--at", "0.4:0.8", "--blend", "-1"]) == 1
    assert "cannot last -1.0 s" in capsys.readouterr().err and not out.exists()


def test_times_in_wrong_units_are_refused_before_memory_is_allocated(saved, tmp_path, capsys):
    save_take(replace(saved[0], times=saved[0].times * 1e9), tmp_path / "long.facetake")
    line = ["mend", str(tmp_path / "long.facetake"), "-o", str(tmp_path / "out.facetake"), "--rate", "30"]
    assert cli.main(line) == 1
    assert "check that the times of the take are in seconds" in capsys.readouterr().err


def test_a_damaged_take_is_used_and_its_losses_are_reported(saved, tmp_path, capsys):
    saved[1].write_bytes(saved[1].read_bytes()[:-40])
    assert cli.main(["export", str(saved[1]), "-o", str(tmp_path / "take.csv")]) == 0
    assert "up to a second after 2.36 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--trim", "9:10"], "There is no frame"),
        (["--trim", "2:1"], "not a time span"),
        (["--trim", "x:1"], "not a time span"),
        (["--rate", "0"], "cannot be"),
        (["--shift", "nan"], "cannot be shifted by nan s"),
        (["--shift", "1e300"], "cannot be shifted by"),
        (["--at", "0.4:0.8"], "--punch-in"),
        (["--cutoff", "mouth=2"], "--smooth zero-phase"),
        (["--smooth", "zero-phase", "--cutoff", "ears=1"], "is not a cutoff"),
        (["--smooth", "zero-phase", "--cutoff", "mouth=fast"], "is not a cutoff"),
        (["--smooth", "zero-phase", "--cutoff", "mouth=1e-200"], "Use 0.001 Hz or more"),
        (["--neutral", "50"], "Choose another neutral"),
        (["--figure", "curves.txt"], "suffix"),
        (["--punch-in", "none.facetake"], "There is no take"),
    ],
)
def test_invalid_options_of_mend_are_clear_errors_and_leave_no_file(saved, tmp_path, capsys, arguments, words):
    out = tmp_path / "out.facetake"
    assert cli.main(["mend", str(saved[1]), "-o", str(out), *arguments]) == 1
    assert words in capsys.readouterr().err and not out.exists()


def test_spans_and_cutoffs_are_parsed():
    assert parse_span("1.5:4") == (1.5, 4.0) and parse_span(":4") == (-math.inf, 4.0)
    assert parse_cutoffs("mouth=6,right eye=4") == {"mouth": 6.0, "right eye": 4.0} and parse_cutoffs("") == {}
    with pytest.raises(FacemimeError):
        parse_span("4")
