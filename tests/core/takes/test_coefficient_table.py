"""Tables of coefficients from Live Link Face and others are read as takes, and written from takes."""

import csv
import re

import numpy as np
import pytest

from facemime.cli.main import main
from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.errors import SourceError
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, N_COEFFICIENTS, column_of
from facemime.core.streams.protocols.live_link import CURVES
from facemime.core.takes.coefficient_table import (
    LIVE_LINK_ORDER,
    from_coefficient_csv,
    has_coefficients,
    timecode,
    write_coefficient_csv,
)
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.neutral import calibrate

# As the app writes them, in its own order and with capitals.
GOLDEN = (
    "Timecode,BlendShapeCount,EyeBlinkRight,JawRight,JawLeft,JawOpen,MouthRight,MouthLeft,EyeBlinkLeft,TongueOut,"
    "CheekPuff,BrowInnerUp,NoseSneerLeft,HeadYaw,HeadPitch,HeadRoll,LeftEyeYaw\n"
    "23:59:59:58.250,61,0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,0.11,0.12,0.1,0.2,0.05,0.0\n"
    "23:59:59:59.250,61,0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,0.11,0.12,0.1,0.2,0.05,0.0\n"
    "00:00:00:00.250,61,0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,0.11,0.12,0.1,0.2,0.05,0.0\n"
)


@pytest.fixture
def written(tmp_path):
    """Write a text as a table."""

    def write(text: str):
        (tmp_path / "table.csv").write_text(text)
        return tmp_path / "table.csv"

    return write


def sines(count: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, coefficients and rotations that all differ."""
    phase = np.arange(count)[:, None] / 9.0 + np.arange(N_COEFFICIENTS)
    turns = 0.3 * np.sin(np.arange(count)[:, None] / 7.0 + np.arange(3))
    return np.arange(count) / 60.0, 0.5 + 0.5 * np.sin(phase), turns


def test_live_link_faces_own_table_is_read_by_name_past_midnight(written):
    take = from_coefficient_csv(written(GOLDEN))
    np.testing.assert_allclose(take.times, [0.0, 1 / 60, 2 / 60], atol=1e-9)
    for name, value in (("eyeBlinkRight", 0.1), ("jawRight", 0.2), ("jawLeft", 0.3), ("jawOpen", 0.4)):
        assert take.coefficients[0, COEFFICIENT_INDEX[name]] == pytest.approx(value)
    assert take.info["measured"] and take.found.all()
    assert take.pose[0, 1] < -0.15 and take.pose[0, 2] < -0.05  # pitch up, yaw to the performer's left


@pytest.mark.parametrize("live_link", [True, False])
def test_a_table_survives_writing_and_reading(tmp_path, live_link):
    times, values, turns = sines()
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, live_link=live_link)
    assert has_coefficients(tmp_path / "a.csv")
    take = from_coefficient_csv(tmp_path / "a.csv")
    np.testing.assert_allclose(take.times, times, atol=1e-5)
    np.testing.assert_allclose(take.coefficients, values, atol=1e-7)
    np.testing.assert_allclose(take.pose[:, 1:4], turns, atol=1e-6)
    np.testing.assert_allclose(arkit_coefficients(take, calibrate(take)), values, atol=1e-7)


def test_angles_of_the_eyes_are_read_and_written_again(tmp_path):
    times, values, turns = sines()
    eyes = 0.4 * np.sin(np.arange(len(times))[:, None, None] / 5.0 + np.array([[0.0, 1.0], [0.0, 1.2]]))
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, eyes, live_link=True)
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "a.facetake")]) == 0
    assert main(["export", str(tmp_path / "a.facetake"), "-o", str(tmp_path / "b.csv"), "--columns", "livelink"]) == 0
    first, second = (list(csv.reader((tmp_path / f"{name}.csv").open())) for name in "ab")
    assert first[0][-6:] == [
        "LeftEyeYaw",
        "LeftEyePitch",
        "LeftEyeRoll",
        "RightEyeYaw",
        "RightEyePitch",
        "RightEyeRoll",
    ]
    angles = [np.array([row[-6:] for row in rows[1:]], float) for rows in (first, second)]
    assert np.abs(angles[0]).max(axis=0).min() > 0.05
    np.testing.assert_allclose(angles[1], angles[0], atol=2e-4)
    np.testing.assert_allclose(load_take(tmp_path / "a.facetake").gaze, eyes.mean(axis=1), atol=1e-4)


def test_a_take_that_is_exported_and_imported_is_the_same(tmp_path):
    times, values, turns = sines()
    eyes = 0.3 * np.sin(np.arange(len(times))[:, None, None] / 5.0 + np.array([[0.0, 1.0], [0.0, 1.2]]))
    write_coefficient_csv(tmp_path / "0.csv", times, values, turns, eyes, live_link=True)
    takes = []
    for number in range(2):
        path = tmp_path / f"{number}.facetake"
        assert main(["import", str(tmp_path / f"{number}.csv"), "-o", str(path)]) == 0
        takes.append(load_take(path))
        out = str(tmp_path / f"{number + 1}.csv")
        assert main(["export", str(path), "-o", out, "--columns", "livelink"]) == 0
    for name in ("times", "coefficients", "pose", "gaze", "vergence"):
        np.testing.assert_array_equal(getattr(takes[1], name), getattr(takes[0], name), err_msg=name)


@pytest.mark.parametrize(("unit", "scale"), [("radians", 1.0), ("degrees", 180.0 / np.pi)])
@pytest.mark.parametrize("largest", [0.5, 1.0, 20.0])
def test_the_eyes_tell_the_unit_of_a_head_that_hardly_turns(tmp_path, unit, scale, largest):
    times, values, _ = sines()
    down = 0.61 * (values[:, COEFFICIENT_INDEX["eyeLookDownLeft"]] - values[:, COEFFICIENT_INDEX["eyeLookUpLeft"]])
    eyes = np.stack([down, np.zeros(len(times))], axis=1)[:, None].repeat(2, axis=1)
    for side in ("Down", "Up"):
        values[:, COEFFICIENT_INDEX[f"eyeLook{side}Right"]] = values[:, COEFFICIENT_INDEX[f"eyeLook{side}Left"]]
    turns = np.radians([0.0, largest, 0.0]) * np.sin(np.arange(len(times)) / 6)[:, None]
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, eyes, live_link=True)
    head, *rows = csv.reader((tmp_path / "a.csv").open())
    scaled = [[*row[:-9], *(f"{scale * float(cell):.9f}" for cell in row[-9:])] for row in rows]
    (tmp_path / "b.csv").write_text("\n".join(map(",".join, [head, *scaled])))
    take = from_coefficient_csv(tmp_path / "b.csv")
    assert unit in take.info["notes"][-1]
    np.testing.assert_allclose(take.pose[:, 1:4], turns, atol=1e-6)
    np.testing.assert_allclose(take.gaze, eyes[:, 0], atol=1e-4)


def test_the_exported_header_is_live_link_faces(tmp_path):
    write_coefficient_csv(tmp_path / "a.csv", *sines(2), live_link=True)
    head = next(csv.reader((tmp_path / "a.csv").open()))
    assert head[:4] == ["Timecode", "BlendShapeCount", "EyeBlinkLeft", "EyeLookDownLeft"]
    assert head[17:20] == ["JawRight", "JawLeft", "JawOpen"] and len(head) == 63
    assert head[-9:-5] == ["HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw"]
    assert LIVE_LINK_ORDER != CURVES and sorted(LIVE_LINK_ORDER) == sorted(COEFFICIENTS)


@pytest.mark.parametrize(
    ("column", "cells", "times"),
    [
        ("time", ("1.5", "1.75"), (0.0, 0.25)),
        ("timestamp_ms", ("100", "140"), (0.0, 0.04)),
        ("frame", ("7", "8"), (0.0, 1 / 30)),
    ],
)
def test_other_tables_may_have_seconds_milliseconds_or_no_times(written, column, cells, times):
    names = [name.replace("Left", "_L").replace("Right", "_R") for name in COEFFICIENTS[:20]]
    rows = [",".join([cell, *["0.25"] * 20]) for cell in cells]
    take = from_coefficient_csv(written("\n".join([",".join([column, *names]), *rows]) + "\n"))
    np.testing.assert_allclose(take.times, times, atol=1e-9)
    assert (take.coefficients[0, :20] == 0.25).all() and (take.coefficients[0, 20:] == 0.0).all()


def test_degrees_are_distinguished_from_radians(written):
    degrees = GOLDEN.replace("0.1,0.2,0.05,0.0\n", "5.7296,11.459,2.8648,0.0\n")
    np.testing.assert_allclose(
        from_coefficient_csv(written(degrees)).pose[:, 1:4],
        from_coefficient_csv(written(GOLDEN)).pose[:, 1:4],
        atol=1e-4,
    )


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32", "cp1252"])
@pytest.mark.parametrize(("separator", "comma"), [(",", False), (";", False), (";", True), ("\t", True), ("|", False)])
def test_a_table_that_a_spreadsheet_saved_again_is_the_same(tmp_path, encoding, separator, comma):
    times, values, turns = sines()
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, live_link=True)
    rows = list(csv.reader((tmp_path / "a.csv").open()))
    text = "\n".join(separator.join(cell.replace(".", ",") if comma else cell for cell in row) for row in rows)
    (tmp_path / "b.csv").write_bytes(text.encode(encoding))
    assert has_coefficients(tmp_path / "b.csv")
    take = from_coefficient_csv(tmp_path / "b.csv")
    np.testing.assert_allclose(take.times, times, atol=1e-5)
    np.testing.assert_allclose(take.coefficients, values, atol=1e-7)


def test_a_table_may_say_its_separator_in_the_first_line(tmp_path):
    times, values, turns = sines()
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, live_link=True)
    text = (tmp_path / "a.csv").read_text().replace(",", ";")
    (tmp_path / "b.csv").write_text("sep=;\n" + text)
    np.testing.assert_allclose(from_coefficient_csv(tmp_path / "b.csv").coefficients, values, atol=1e-7)


@pytest.mark.parametrize("prefix", ["blendShapes.", "BS_node.", "Head|", "rig:", "Face/"])
def test_the_prefix_of_a_node_does_not_matter(written, prefix):
    head, *rows = GOLDEN.splitlines()
    titles = [prefix + title if title[0] in "EJMTCBN" else title for title in head.split(",")]
    take = from_coefficient_csv(written("\n".join([",".join(titles).replace(prefix + "Blend", "Blend"), *rows])))
    assert take.coefficients[0, COEFFICIENT_INDEX["jawOpen"]] == pytest.approx(0.4)


def test_seconds_in_a_column_of_timecodes_are_seconds(written):
    names = [name[0].upper() + name[1:] for name in COEFFICIENTS]
    rows = [",".join([f"{i / 30:.6f}", *["0.5"] * 52]) for i in range(30)]
    take = from_coefficient_csv(written("\n".join([",".join(["timeCode", *names]), *rows])))
    np.testing.assert_allclose(take.times, np.arange(30) / 30, atol=1e-5)


def test_a_few_repeated_rows_are_left_out_and_said(tmp_path):
    times, values, turns = sines(300)
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, live_link=True)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "b.csv").write_text("\n".join([*lines[:151], lines[150], lines[120], *lines[151:]]))
    take = from_coefficient_csv(tmp_path / "b.csv")
    np.testing.assert_allclose(take.times, times, atol=1e-5)
    assert "2 of 302 rows" in take.info["notes"][0]
    (tmp_path / "c.csv").write_text("\n".join([lines[0], *(line for line in lines[1:] for _ in range(2))]))
    with pytest.raises(SourceError, match="do not increase"):
        from_coefficient_csv(tmp_path / "c.csv")


def table_of(times, title="time", names=COEFFICIENTS[:20], value="0.25", before="", below="", between="", end="\n"):
    """A table of 20 coefficients with one value, as another program may write it."""
    head = ",".join([title, *names])
    rows = [between + ",".join([time, *[value] * len(names)]) for time in times]
    return before + end.join([head, *filter(None, [below]), *rows]) + end


@pytest.mark.parametrize(
    ("title", "factor", "note"),
    [
        *[(title, 1.0, "") for title in ("Time (s)", "time_sec", "Timestamp", "Elapsed Time", "t", "Time Code")],
        *[("Time [ms]", 1e3, ""), ("timestamp", 1e3, "milliseconds"), ("time", 1e6, "microseconds")],
        *[
            ("timestamp_us", 1e6, ""),
            ("TimeNs", 1e9, ""),
            ("frame", 25.0, "no times"),
            ("Frame Number", 50.0, "no times"),
        ],
    ],
)
def test_times_are_found_under_any_title_and_in_any_unit(written, title, factor, note):
    take = from_coefficient_csv(written(table_of([f"{1000 + factor * i / 25:.6f}" for i in range(20)], title)))
    rate = factor if "rame" in title else 25.0
    np.testing.assert_allclose(
        take.times, np.arange(20) * (factor / 25 / 30 if note == "no times" else 1 / rate), atol=1e-6
    )
    assert note in "".join(take.info.get("notes", [])) and bool(note) == ("notes" in take.info)


def test_numbers_of_frames_count_at_the_rate_that_the_table_states(written):
    text = table_of([f"{i},25" for i in (1001, 1002, 1005)], "Frame,FPS")
    np.testing.assert_allclose(from_coefficient_csv(written(text)).times, [0.0, 0.04, 0.16], atol=1e-9)


@pytest.mark.parametrize(
    "how",
    [
        *(
            {"before": before}
            for before in ("\n\n", "# written by a program\n# fps: 30\n", "Take 3,,,\n\n", '"sep=,"\n')
        ),
        *({"below": below} for below in ("s" + ",-" * 20, "(s)" + ",(0-1)" * 20, "," * 20)),
        *({"between": between} for between in ("\n", " , ,\n", "# a comment\n")),
        *({"end": end} for end in ("\r", "\r\n", ",\n")),
        {"value": "25%"},
        {"value": '"0,25"'},
    ],
)
def test_what_other_programs_write_around_the_numbers_does_not_matter(written, how):
    (path := written("")).write_bytes(table_of([f"{i / 25:.3f}" for i in range(12)], **how).encode())
    take = from_coefficient_csv(path)
    np.testing.assert_allclose(take.times, np.arange(12) / 25, atol=1e-9)
    np.testing.assert_allclose(take.coefficients[:, :20], 0.25)


@pytest.mark.parametrize(
    "spelling",
    [
        lambda name: re.sub("([A-Z])", r"_\1", name).lower(),
        lambda name: re.sub("([A-Z])", r" \1", name).upper(),
        lambda name: re.sub("([A-Z])", r"-\1", name),
        lambda name: re.sub("Left$", ".L", re.sub("Right$", ".R", name)),
        lambda name: re.sub("Left$", "_l", re.sub("Right$", "_r", name)),
        lambda name: f"ARKit_{name}",
        lambda name: f"weights[{name}]",
        lambda name: f"Face.{name}.weight",
    ],
)
def test_every_coefficient_is_known_in_any_spelling(spelling):
    assert [column_of(spelling(name)) for name in COEFFICIENTS] == list(range(N_COEFFICIENTS))


def test_halves_of_a_coefficient_are_averaged_and_no_column_may_come_twice(written):
    whole = [name for name in COEFFICIENTS[:20] if name not in ("browInnerUp", "cheekPuff")]
    names = [*whole, "browInnerUp_L", "browInnerUp_R", "cheekPuff_L"]
    values = ["0.25"] * (len(names) - 3) + ["0.8", "0.4", "0.5"]
    rows = [",".join([time, *values]) for time in ("0", "0.04", "0.08")]
    take = from_coefficient_csv(written("\n".join([",".join(["time", *names]), *rows])))
    np.testing.assert_allclose(take.coefficients[:, COEFFICIENT_INDEX["browInnerUp"]], 0.6)
    np.testing.assert_allclose(take.coefficients[:, COEFFICIENT_INDEX["cheekPuff"]], 0.5)
    with pytest.raises(SourceError, match="two of its columns are the same coefficient"):
        twice = [",".join(["time", *names, "BrowInnerUpLeft"]), *(f"{row},0" for row in rows)]
        from_coefficient_csv(written("\n".join(twice)))


def test_missing_values_are_interpolated_and_rows_without_any_have_no_face(written):
    lines = table_of([f"{i / 25:.3f}" for i in range(6)]).splitlines()
    values = [lines[0], lines[1], lines[2].replace("0.25", "nan", 1), lines[3].replace("0.25", "0.75", 1), *lines[4:]]
    values[5] = "0.16" + ",N/A" * 20
    take = from_coefficient_csv(written("\n".join(values)))
    np.testing.assert_allclose(take.coefficients[:4, 0], [0.25, 0.5, 0.75, 0.25])
    assert take.found.tolist() == [True] * 4 + [False, True] and "1 of 6 rows have no" in take.info["notes"][0]


def test_percentages_are_recognised_and_said(written):
    take = from_coefficient_csv(written(table_of(["0", "0.04"], value="25")))
    np.testing.assert_allclose(take.coefficients[:, :20], 0.25)
    assert "percentages" in take.info["notes"][0]


def test_a_title_may_state_the_unit_of_the_angles(written):
    text = table_of(["0,1", "0.04,1"], "time,Head Yaw (deg)")
    assert from_coefficient_csv(written(text)).pose[0, 2] == pytest.approx(-np.radians(1.0))


@pytest.mark.parametrize(("largest", "unit"), [(0.3, "radians"), (1.2, "radians"), (2.5, "degrees"), (25.0, "degrees")])
def test_the_unit_of_angles_is_decided_over_the_whole_table_said_and_overridden(tmp_path, largest, unit):
    times, values, _ = sines()
    turns = np.zeros((len(times), 3))
    write_coefficient_csv(tmp_path / "a.csv", times, values, turns, live_link=True)
    rows = list(csv.reader((tmp_path / "a.csv").open()))
    yaw = rows[0].index("HeadYaw")
    for i, row in enumerate(rows[1:]):
        row[yaw] = f"{largest * np.sin(i / 6):.6f}"
    (tmp_path / "b.csv").write_text("\n".join(map(",".join, rows)))
    take = from_coefficient_csv(tmp_path / "b.csv")
    assert unit in take.info["notes"][-1]
    wanted = np.radians(largest) if unit == "degrees" else largest
    assert np.abs(take.pose[:, 2]).max() == pytest.approx(wanted, rel=0.02)
    other = from_coefficient_csv(tmp_path / "b.csv", "degrees")
    assert np.abs(other.pose[:, 2]).max() == pytest.approx(np.radians(largest), rel=0.02)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a,b,c\n1,2,3\n", "are coefficients"),
        (GOLDEN.splitlines()[0] + "\n", "no rows"),
        (GOLDEN.replace("0.4", "x"), "not a possible number"),
        (GOLDEN.replace("0.4", "inf"), "not a possible number"),
        (GOLDEN.replace("0.4", "1e400"), "not a possible number"),
        (GOLDEN.replace("23:59:59:58.250", "hello"), "not a timecode"),
        (GOLDEN.replace("23:59:59:58.250", "23:59:59:59.250"), "do not increase"),
        (GOLDEN.replace("JawRight", "jawOpen"), "the same coefficient"),
    ],
)
def test_invalid_tables_are_refused_with_the_reason(written, text, match):
    with pytest.raises(SourceError, match=match):
        from_coefficient_csv(written(text))


def test_timecodes_count_frames_and_thousandths():
    assert timecode(0.0, 60.0) == "00:00:00:00.000" and timecode(3661.5, 60.0) == "01:01:01:30.000"
    assert timecode(1.0 / 120.0, 60.0) == "00:00:00:00.500"


def test_the_command_imports_a_table_and_exports_the_same_values(tmp_path, written):
    assert main(["import", str(written(GOLDEN)), "-o", str(tmp_path / "a.facetake")]) == 0
    take = load_take(tmp_path / "a.facetake")
    for columns in ("livelink", "coefficients"):
        out = tmp_path / f"{columns}.csv"
        assert main(["export", str(tmp_path / "a.facetake"), "-o", str(out), "--columns", columns]) == 0
        again = from_coefficient_csv(out)
        np.testing.assert_allclose(again.coefficients, take.coefficients, atol=1e-5)
        np.testing.assert_allclose(again.pose[:, 1:4], take.pose[:, 1:4], atol=1e-4)


@pytest.mark.parametrize(("suffix", "separator"), [(".tsv", "\t"), (".txt", "\t"), (".CSV", ";")])
def test_a_table_may_have_any_suffix_of_a_spreadsheet(tmp_path, suffix, separator):
    (tmp_path / f"a{suffix}").write_bytes(GOLDEN.replace(",", separator).encode("utf-16"))
    assert main(["import", str(tmp_path / f"a{suffix}"), "-o", str(tmp_path / "a.facetake")]) == 0
    assert len(load_take(tmp_path / "a.facetake")) == 3


def test_a_tracked_take_exports_coefficients_too(tmp_path, take):
    out = tmp_path / "a.csv"
    assert main(["export", str(take), "-o", str(out), "--columns", "coefficients"]) == 0
    tracked, found = load_take(take), from_coefficient_csv(out)
    assert len(found) == tracked.found.sum()
    wanted = arkit_coefficients(tracked, calibrate(tracked))
    np.testing.assert_allclose(found.coefficients, wanted, atol=1e-6)


def test_a_take_of_coefficients_keeps_them_in_facemimes_own_table(tmp_path, written):
    save_take(from_coefficient_csv(written(GOLDEN)), tmp_path / "a.facetake")
    assert main(["export", str(tmp_path / "a.facetake"), "-o", str(tmp_path / "a.csv")]) == 0
    assert main(["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "b.facetake")]) == 0
    first, second = load_take(tmp_path / "a.facetake"), load_take(tmp_path / "b.facetake")
    np.testing.assert_array_equal(first.coefficients, second.coefficients)
