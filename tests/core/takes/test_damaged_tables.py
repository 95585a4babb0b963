"""Tables that a program could not finish, and values that cannot be, do not cost the rest of a recording."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from facemime.core.errors import SourceError
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.takes.coefficient_table import LIVE_LINK_ORDER
from facemime.core.takes.recordings import read_recording
from facemime.core.takes.spreadsheet import from_csv, to_csv
from tests.helpers.recordings import face_cap, openface
from tests.helpers.tables import NAMES, stamps, table_lines
from tests.helpers.takes import make_take


@pytest.fixture
def read(tmp_path):
    """Write lines, a text or bytes as a table, and read it."""

    def write(content):
        data = "\n".join(content) if isinstance(content, list) else content
        (tmp_path / "table.csv").write_bytes(data if isinstance(data, bytes) else data.encode())
        return read_recording(tmp_path / "table.csv")

    return write


def notes(take):
    return " ".join(take.info.get("notes", []))


LINES = table_lines(stamps(90))
TEXT = "\n".join([*LINES, ""])


@pytest.mark.parametrize("cut", [6, 16, 24, 60])
@pytest.mark.parametrize("zeros", [0, 1, 400, 200_000])
def test_a_last_row_that_was_cut_short_is_left_out_and_said(read, cut, zeros):
    take = read("\n".join([*LINES[:-1], LINES[-1][:cut]]) + "\0" * zeros)
    assert len(take) == 89 and "last row was cut short" in notes(take)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-32"])
def test_zeros_at_the_end_do_not_cost_a_row(read, encoding):
    assert len(read(TEXT.encode(encoding) + b"\0" * 401)) == 90


def test_a_bad_last_value_is_left_out_with_its_row(read):
    take = read([*LINES[:-1], LINES[-1].replace(",0.", ",0.x", 1)])
    assert len(take) == 89 and "last row" in notes(take)


def test_repeated_titles_are_left_out_and_counted(read):
    units = "hh:mm:ss:ff" + ",-" * len(NAMES)
    take = read([*LINES[:30], LINES[0], *LINES[30:60], LINES[0], units.replace(":", "/"), *LINES[60:]])
    assert len(take) == 90 and "titles were left out: 2" in notes(take)
    np.testing.assert_allclose(np.diff(take.times), 1 / 60, atol=1e-6)


def test_a_bad_value_in_the_middle_is_named(read):
    lines = list(LINES)
    lines[41] = lines[41].replace("0.", "0.x", 3)
    with pytest.raises(SourceError, match=r"row 41 has .*0\.x.*, which is not"):
        read(lines)


def test_a_cut_table_of_action_units_is_read_up_to_there_and_a_bad_value_is_named(read):
    text = openface([{"AU26_r": 1.0} for _ in range(30)]).rstrip("\n")
    take = read(text[:-7])
    assert len(take) == 29 and "last row was cut short" in notes(take)
    lines = text.split("\n")
    lines[10] = lines[10].replace("0.98", "x")
    with pytest.raises(SourceError, match=re.escape("row 10 has 'x' for confidence")):
        read(lines)


def test_a_cut_recording_of_face_cap_is_read_up_to_there(tmp_path):
    text = face_cap([(16 * i, (0, 0, 0), {"jawOpen": 0.5}) for i in range(20)])
    (tmp_path / "a.txt").write_text(text[:-40] + "\0" * 300)
    take = read_recording(tmp_path / "a.txt")
    assert len(take) == 19 and "last row was cut short" in notes(take)


def test_a_cut_table_of_a_take_is_read_up_to_there(tmp_path):
    take = make_take(np.random.default_rng(1).normal(size=(20, 66, 3)))
    to_csv(take, tmp_path / "a.csv")
    text = (tmp_path / "a.csv").read_text()
    (tmp_path / "a.csv").write_text(text[: text.rindex("\n", 0, -2) + 300] + "\0" * 5000)
    again = from_csv(tmp_path / "a.csv")
    assert len(again) == 19 and "last row was cut short" in notes(again)
    np.testing.assert_array_equal(again.shape, take.shape[:19])


def cells(lines, row, value, column=7):
    """Lines with another value in a row."""
    changed = lines[row].split(",")
    changed[column] = str(value)
    return [*lines[:row], ",".join(changed), *lines[row + 1 :]]


@pytest.mark.parametrize("value", [6.0, 4000.0, -9999.0])
def test_an_outlier_does_not_make_a_table_percentages(read, value):
    take = read(cells(cells(LINES, 40, value), 60, value, 9))
    right = read(LINES)
    assert np.abs(take.coefficients - right.coefficients).max() < 0.5
    assert "percentages" not in notes(take) and f"interpolated: 2, the first one of {NAMES[6]}" in notes(take)


def of_percentages(values):
    """Lines of a table in which one column has percentages (N,) and the others have a value each."""
    rows = [",".join([str(i / 30), f"{value:g}", *["0"] * 19]) for i, value in enumerate(values)]
    return [",".join(["time", *NAMES]), *rows]


BLINKS = np.where(np.arange(300) % 100 < 6, 80.0, 0.0)


@pytest.mark.parametrize(
    "values",
    [
        50.0 + 50.0 * np.sin(np.arange(300) / 9),
        BLINKS,
        BLINKS + 2.0 + np.sin(np.arange(300) / 9),
        np.where(np.arange(300) == 100, 7.0, 3.0 + np.sin(np.arange(300) / 9)),
    ],
    ids=["all", "blinks of a face at rest", "blinks of a quiet face", "a single large value"],
)
def test_percentages_are_recognised_even_if_few_are_large(read, values):
    take = read(of_percentages(values))
    np.testing.assert_allclose(take.coefficients[:, 0], values / 100.0, atol=1e-6)
    assert "percentages" in notes(take)


def test_exaggerated_coefficients_are_no_percentages(read):
    values = 1.0 + np.sin(np.arange(300) / 9)
    np.testing.assert_allclose(read(of_percentages(values)).coefficients[:, 0], values.clip(max=1.0), atol=1e-5)


def test_the_node_with_most_coefficients_counts_of_several(read):
    head = ["time", *(f"Teeth|{name}" for name in LIVE_LINK_ORDER[14:18]), *(f"Head|{n}" for n in LIVE_LINK_ORDER)]
    take = read([",".join(head), *(",".join([str(i / 30), *["0.9"] * 4, *["0.1"] * 52]) for i in range(10))])
    np.testing.assert_allclose(take.coefficients, 0.1)
    assert "Those of Head were used" in notes(take)


def test_the_face_with_most_rows_counts_of_several(read):
    lines = table_lines(
        [f"{i / 30},{face}" for i in range(20) for face in (3, 4) if face == 4 or i > 5], "time,face_id"
    )
    take = read(lines)
    np.testing.assert_allclose(take.times, np.arange(20) / 30, atol=1e-6)
    assert "has 2 faces. Only face 4" in notes(take)
    assert take.coefficients[:, COEFFICIENT_INDEX[NAMES[0]]].all()


WEIGHTS = [[0.1 * frame + 0.01 * column for column in range(52)] for frame in range(5)]
JSON = {
    "BEAT": {
        "names": list(LIVE_LINK_ORDER),
        "frames": [{"weights": row, "time": i / 30, "rotation": []} for i, row in enumerate(WEIGHTS)],
    },
    "a list of objects": [
        {"timestamp": i / 30, "blendShapes": dict(zip(LIVE_LINK_ORDER, row, strict=True))}
        for i, row in enumerate(WEIGHTS)
    ],
    "flat objects": [{"time": i / 30, **dict(zip(LIVE_LINK_ORDER, row, strict=True))} for i, row in enumerate(WEIGHTS)],
    "names and numbers at a rate": {"fps": 30, "blendshapes": list(LIVE_LINK_ORDER), "data": WEIGHTS},
    "MediaPipe": {
        "frames": [
            {
                "timestamp_ms": i * 1000 / 30,
                "faceBlendshapes": [
                    {"index": n, "score": value, "categoryName": name}
                    for n, (name, value) in enumerate(zip(LIVE_LINK_ORDER, row, strict=True))
                ],
            }
            for i, row in enumerate(WEIGHTS)
        ]
    },
}


@pytest.mark.parametrize("data", JSON.values(), ids=JSON)
def test_frames_in_json_are_read_by_the_names_of_their_values(tmp_path, data):
    (tmp_path / "a.json").write_text(json.dumps(data))
    take = read_recording(tmp_path / "a.json")
    np.testing.assert_allclose(take.times, np.arange(5) / 30, atol=1e-6)
    places = [COEFFICIENT_INDEX[name] for name in LIVE_LINK_ORDER]
    np.testing.assert_allclose(take.coefficients[:, places], WEIGHTS, atol=1e-6)


@pytest.mark.parametrize("data", ["{}", "[]", "3", '{"frames": [1, 2]}', '[{"a": 1}]', '{"names": [], "frames": [[]]}'])
def test_json_without_coefficients_is_refused(tmp_path, data):
    (tmp_path / "a.json").write_text(data)
    with pytest.raises(SourceError, match=r"a\.json cannot be read"):
        read_recording(tmp_path / "a.json")


def test_a_table_with_other_names_is_refused_with_what_it_needs(read):
    with pytest.raises(SourceError, match="at least ten, named as ARKit"):
        read("time,CTRL_expressions_jawOpen,CTRL_expressions_browDownL\n0,0.1,0.2\n1,0.1,0.2\n")


def test_a_file_that_is_no_text_is_refused_in_words(read):
    with pytest.raises(SourceError, match="it is not text"):
        read(bytes(range(256)) * 4)
