"""JSON of control points, key mappings, presets and calibrations is checked before use."""

from __future__ import annotations

import copy
import json
from math import inf, nan

import numpy as np
import pytest

from facemime.core.control_points import selection as control_points
from facemime.core.control_points.select import parse_landmarks
from facemime.core.control_points.selection import GreedySelection, GreedyStep
from facemime.core.errors import OutputError, SourceError
from facemime.core.files.reading import MAX_TEXT, parse_json, read_bytes, read_text
from facemime.core.files.setting import Choice, Setting
from facemime.core.heads import key_map
from facemime.core.heads.regions import membership
from facemime.core.puppet import presets
from facemime.core.puppet.presets import file_name
from facemime.core.takes.neutral import Neutral, calibrate
from tests.helpers.takes import performance

STEP = GreedyStep("start", 20, 0, "frontalis", 1, 0.05, 3, 8)
POINTS = json.loads(control_points.to_json(GreedySelection(membership(), (STEP, STEP), 0.01, True, np.eye(66) * 1e-4)))
TABLE = {"format": "facemime-key-map", "name": "Mine", "rows": [{"source": "jawOpen", "key": "a", "gain": 1.0}]}
KNOWN = {
    "settings": {
        "smoothing": Setting(1.0, "Smoothing", low=0.0, high=20.0),
        "kernel": Setting("gaussian", "Skin", choices=(Choice("gaussian", "Gaussian", ""),)),
        "mirror": Setting(False, "Mirror"),
    },
    "posing": {"eyes_limit": Setting(0.5, "Eyes Limit", low=0.0, high=1.5)},
}
PRESET = {"format": "facemime-preset", "settings": {"smoothing": 2.0, "mirror": True}, "posing": {"eyes_limit": 1}}


def changed(data: dict, value: object, *place: object) -> str:
    """Return the JSON of `data` with `value` at `place`."""
    data = owner = copy.deepcopy(data)
    for key in place[:-1]:
        owner = owner[key]
    owner[place[-1]] = value
    return json.dumps(data)


@pytest.mark.parametrize("value", [nan, inf, -inf, 10**400, 10**30, True, "1", None, [], -1, 70, 2.5])
@pytest.mark.parametrize("field", ["landmark", "region", "points", "frame", "worst"])
def test_a_step_of_a_selection_has_integers_in_range(field, value):
    if field == "frame" and value == 70:
        return
    with pytest.raises(SourceError, match="not a control point file"):
        control_points.from_json(changed(POINTS, value, "steps", 1, field))


@pytest.mark.parametrize(
    ("value", "place"),
    [
        *((value, ("steps", 0, "error")) for value in (inf, -1.0, 1e308, 10**400, "0.1", None)),
        *((value, ("steps", 0, "reason")) for value in (3, None, ["a"], "long" * 1000)),
        *((value, ("steps", 0, "action")) for value in (3, "jump", [])),
        *((value, ("tolerance",)) for value in (nan, inf, -0.1, "0.01", 10**400)),
        *((value, ("reached",)) for value in (1, "yes", None)),
        *((value, ("regions",)) for value in ([], [[17], [33]], 3, [[17], [33], []], [[17], [33], [17]])),
        *((value, ("regions", 0, 0)) for value in (True, 1.0, "17", -1, 60, 10**30)),
        *((value, ("covariance",)) for value in ([], 3, [nan] * 2211, [inf] * 2211, [-1.0] * 2211, ["x"] * 2211)),
        *((value, ("steps",)) for value in (3, {}, [3], [{}], None)),
    ],
)
def test_control_points_of_the_wrong_type_are_refused(value, place):
    with pytest.raises(SourceError, match="not a control point file"):
        control_points.from_json(changed(POINTS, value, *place))


def test_control_points_changed_by_hand_have_no_error():
    again = control_points.from_json(changed(POINTS, nan, "steps", 1, "error"))
    assert np.isnan(again.steps[1].error) and again.steps[0] == STEP


@pytest.mark.parametrize(
    ("value", "place"),
    [
        *((value, ("rows", 0, "gain")) for value in (nan, inf, 10**400, 10**30, "1", True, None, [])),
        *((value, ("rows", 0, "key")) for value in (3, None, "\ud800", "long" * 1000)),
        *((value, ("rows",)) for value in (3, {}, [3], None)),
        *((value, ("name",)) for value in (3, None)),
    ],
)
def test_a_key_mapping_with_wrong_types_is_refused(value, place):
    with pytest.raises(SourceError, match="not a key mapping") as caught:
        key_map.from_json(changed(TABLE, value, *place))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("value", "place"),
    [
        *((value, ("settings", "smoothing")) for value in (nan, inf, -1, 21, 10**400, "2", True, None)),
        *((value, ("settings", "mirror")) for value in (1, "true")),
        *((value, ("settings", "kernel")) for value in (1, "magic")),
        *((value, ("settings",)) for value in (1, [], None)),
        *((value, ("format",)) for value in (1, "other", None)),
    ],
)
def test_a_preset_is_checked_as_a_whole(value, place):
    with pytest.raises(SourceError, match="not a Facemime preset"):
        presets.from_json(changed(PRESET, value, *place), KNOWN)


def test_a_preset_sets_only_what_it_contains():
    assert presets.from_json(changed(PRESET, "x", "settings", "later"), KNOWN) == {
        "settings": {"smoothing": 2.0, "mirror": True},
        "posing": {"eyes_limit": 1.0},
    }


@pytest.mark.parametrize(
    "name", ["", " ", ".", "a/b", "a\\b", "a:b", "x\ny", "x\ud800", "CON", "nul.txt", "end.", "x" * 201]
)
def test_names_that_are_invalid_on_any_system_are_refused(name):
    with pytest.raises(OutputError, match="cannot be used as the name of a preset") as caught:
        file_name(name)
    assert len(str(caught.value)) < 200


def test_names_in_any_script_are_accepted():
    assert [file_name(name) for name in (" Calm ", "静か", "Mk. 2", "console")] == [
        *("Calm.json", "静か.json", "Mk. 2.json", "console.json")
    ]


@pytest.fixture(scope="module")
def calibration() -> dict:
    return calibrate(performance()).to_dict()


def test_a_calibration_survives_storage(calibration):
    again = Neutral.from_json(json.dumps(calibration))
    assert again.to_dict() == calibration
    assert again.mirrored().to_dict() == Neutral.from_dict(again.mirrored().to_dict()).to_dict()


@pytest.mark.parametrize(
    ("value", "place"),
    [
        *((value, ("shape", 3, 0)) for value in (nan, inf, 1e300, 10**400, "x", None)),
        *((value, ("shape",)) for value in ([], [[0.0, 0.0, 0.0]] * 66, {}, "x")),
        *((value, ("rotation",)) for value in ([[0.0] * 3] * 3, [[2.0, 0, 0], [0, 2.0, 0], [0, 0, 2.0]])),
        *((value, ("position", 0)) for value in (0.0, -1.0, 1e300)),
        *((value, ("gaze", 0)) for value in (inf, 1e300)),
        *((value, ("shut",)) for value in (1.0, -1.0, nan)),
        *((value, ("start",)) for value in (10**400, inf, [], "now")),
    ],
)
def test_an_impossible_calibration_is_refused(calibration, value, place):
    with pytest.raises(SourceError, match="stored calibration is damaged"):
        Neutral.from_json(changed(calibration, value, *place))


@pytest.mark.parametrize("text", ["", "[]", "3", "null", "[" * 100_000, '{"shape": ', "\x00"])
def test_text_that_is_not_a_calibration_is_refused(text):
    with pytest.raises(SourceError, match="stored calibration is damaged"):
        Neutral.from_json(text)


def test_nan_is_read_only_if_allowed():
    assert np.isnan(parse_json("NaN", nan=True))
    for text in ("NaN", "Infinity", "1e999", "1" * 5000, "[" * 100_000, "{"):
        with pytest.raises(ValueError):
            parse_json(text)


def test_a_file_that_is_too_large_or_not_text_is_refused(tmp_path):
    with open(tmp_path / "large", "wb") as stream:
        stream.truncate(MAX_TEXT + 1)
    with pytest.raises(ValueError, match="larger than"):
        read_text(tmp_path / "large")
    (tmp_path / "odd").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="UTF-8"):
        read_text(tmp_path / "odd")
    assert read_bytes(tmp_path / "odd", 2) == b"\xff\xfe"


def test_landmarks_of_an_endless_range_are_refused_at_once():
    from facemime.core.errors import HeadError

    for text in ("0-99999999999", "5-" + "9" * 400, "-" + "9" * 5000):
        with pytest.raises(HeadError, match="not a list of landmarks"):
            parse_landmarks(text)
