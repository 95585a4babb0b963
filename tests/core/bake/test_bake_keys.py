"""Computations of bakes: bounded least squares, fits of keys, tables, caches."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from facemime.core.bake.arkit import arkit_coefficients, coefficients_of
from facemime.core.bake.coefficients import N_OBSERVED
from facemime.core.bake.fit import fit_keys, mix_errors
from facemime.core.bake.point_cache import write_point_cache
from facemime.core.bake.whole_frames import in_between
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.errors import OutputError, SourceError
from facemime.core.face.landmarks import N_LANDMARKS
from facemime.core.face.names import COEFFICIENTS, N_ACTIONS, normalised
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_map import KeyMap, KeyRow, exclusive_keys, from_json, learn_map, load_map
from facemime.core.heads.key_presets import best_preset, expression_keys, known_expressions, presets
from facemime.core.numeric.least_squares import bounded_least_squares
from facemime.core.takes.neutral import calibrate
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    unknowns=st.integers(1, 14),
    extra=st.integers(0, 20),
    rows=st.sampled_from([1, 3, 6]),
    infinite=st.booleans(),
    started=st.booleans(),
)
def test_bounded_least_squares_agrees_with_scipy_from_any_start(seed, unknowns, extra, rows, infinite, started):
    rng = np.random.default_rng(seed)
    matrix, wanted = rng.normal(size=(unknowns + extra, unknowns)), rng.normal(size=(rows, unknowns + extra))
    matrix += 0.3 * np.eye(unknowns + extra, unknowns)
    lower = rng.uniform(-0.4, 0.0, unknowns)
    upper = np.full(unknowns, np.inf) if infinite else lower + rng.uniform(0.01, 0.6, unknowns)
    start = rng.normal(size=(rows, unknowns)) if started else None
    found = bounded_least_squares(matrix.T @ matrix, wanted @ matrix, lower, upper, start)
    assert (found >= lower).all() and (found <= upper).all()
    for x, y in zip(found, wanted, strict=True):
        best = lsq_linear(matrix, y, (lower, upper), method="bvls", tol=1e-14, max_iter=500)
        assert np.square(matrix @ x - y).sum() <= 2.0 * best.cost + 1e-7 * (1.0 + best.cost)


@pytest.mark.parametrize("rows", [1, 6])
def test_a_system_that_is_not_finite_is_refused(rows):
    wanted = np.ones((rows, 3))
    wanted[-1, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        bounded_least_squares(np.eye(3), wanted, np.zeros(3), np.ones(3))
    with pytest.raises(ValueError, match="not finite"):
        bounded_least_squares(np.full((3, 3), np.nan), np.ones((rows, 3)), np.zeros(3), np.ones(3))


def test_the_coefficients_are_the_built_in_heads_face_units():
    assert load_head().unit_names == COEFFICIENTS


def test_the_weights_of_a_motion_are_recovered():
    units = load_head().units
    names = load_head().unit_names
    told = [names.index(name) for name in ("jawOpen", "mouthSmileLeft", "browInnerUp", "eyeBlinkRight")]
    weights = np.zeros((20, len(units)))
    weights[:, told] = np.random.default_rng(0).random((20, len(told)))
    motion = np.tensordot(weights.astype(np.float32), units, axes=1)
    fit = fit_keys(motion, units, np.zeros(len(units)), np.ones(len(units)))
    np.testing.assert_allclose(fit.weights[:, told], weights[:, told], atol=0.03)
    assert fit.mean_error <= fit.worst_error < 5e-4
    assert mix_errors(motion, units, weights) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_keys_stay_within_their_slider_ranges():
    units = load_head().units[:5]
    fit = fit_keys(2.0 * units[:1] - 3.0 * units[1:2], units, np.full(5, -0.5), np.full(5, 0.8))
    assert fit.weights.min() == -0.5 and fit.weights.max() == 0.8 and fit.worst_error > 1e-3


def test_turned_eyes_give_the_coefficients_of_their_direction():
    gaze = np.array([[np.eye(3)] * 2, [euler_to_matrix(0.0, 0.2, 0.0)] * 2])
    found = coefficients_of(np.zeros((2, N_OBSERVED)), np.zeros((2, 3 * N_LANDMARKS)), gaze, np.zeros((2, N_ACTIONS)))
    looking = {name for name, values in zip(COEFFICIENTS, found.T, strict=True) if values[1] > 0.3 and values[0] < 0.05}
    assert looking in ({"eyeLookInLeft", "eyeLookOutRight"}, {"eyeLookOutLeft", "eyeLookInRight"})


def test_a_mirrored_take_has_the_coefficients_of_the_other_side():
    take = performance()
    neutral = calibrate(take)
    plain = arkit_coefficients(take, neutral)
    mirrored = arkit_coefficients(take, neutral, DriveSettings(mirror=True))
    names = COEFFICIENTS
    assert plain.shape == (int(take.found.sum()), 52) and plain.min() >= 0.0 and plain.max() <= 1.0
    for left in ("browOuterUpLeft", "eyeLookOutLeft"):
        right = names.index(left.replace("Left", "Right"))
        np.testing.assert_allclose(plain[:, names.index(left)], mirrored[:, right], atol=0.1)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("eyeBlink_L", "eyeBlinkLeft"),
        ("EyeBlink.R", "eyeBlinkRight"),
        ("Phoneme B,M,P", "BMP"),
        ("Modifier Brow-Down Left", "BrowDownLeft"),
        ("Jaw Open", "jawOpen"),
        ("eyeBlinkL", "eyeBlinkLeft"),
        ("blendShapes_jawOpen", "jawOpen"),
        ("ARKit-mouth_smile_right", "mouthSmileRight"),
    ],
)
def test_names_are_equal_in_any_spelling(one, other):
    assert normalised(one) == normalised(other)


def used(preset):
    """Keys of a table that a mesh with all of them is driven by."""
    return preset.matched(preset.keys).keys


@pytest.mark.parametrize(
    "node",
    [
        "rig:Face|",
        "Face.M_F00_000_00_",
        *(pytest.param(node, marks=pytest.mark.thorough) for node in ("blendShape1.", "Head_blendShapes.")),
    ],
)
def test_the_name_of_a_node_before_that_of_a_key_does_not_matter(node):
    for preset in presets():
        if node.endswith("_") and not preset.keys[0].startswith("Fcl_"):  # as VRoid Studio names its own keys
            continue
        keys = [node + key for key in preset.keys]
        found = best_preset(keys)
        assert (
            found is not None and found.name == preset.name and set(found.keys) == {node + key for key in used(preset)}
        )
        assert known_expressions([*keys, "Other"]) == keys
    pairs = exclusive_keys([node + name for name in ("jawLeft", "jawOpen", "jawRight")])
    assert pairs == ([] if node[-1] == "_" else [(0, 2)])


def test_keys_of_several_nodes_are_all_set_and_give_back_one_coefficient():
    keys = [f"blendShape{node}.{name}" for node in (1, 2) for name in COEFFICIENTS]
    table, values = presets()[0].matched([*keys, "blendShape1.jaw_open"]), np.zeros((2, len(COEFFICIENTS)))
    assert set(table.keys) == set(keys)
    values[1, 3] = 0.7
    posed = table.apply(values, dict.fromkeys(keys, (0.0, 1.0)))
    assert all(posed[f"blendShape{node}.{COEFFICIENTS[3]}"][1] == 0.7 for node in (1, 2))
    np.testing.assert_allclose(table.invert(posed, np.full_like(values, 0.5)), values)


def test_names_that_merely_end_in_l_or_r_are_unchanged():
    assert normalised("R") == "r" and normalised("Curl") == "curl"


@pytest.mark.parametrize("preset", presets(), ids=lambda preset: preset.name)
def test_each_vocabulary_is_recognised_by_its_keys(preset):
    assert best_preset([*preset.keys, "Nose Length"]).name == preset.name
    assert from_json(preset.to_json()) == preset


@pytest.mark.parametrize(("before", "after"), [("Head_", ""), ("facs ", ""), ("", "_Mesh"), ("c_", " head")])
@pytest.mark.parametrize("preset", first_of(presets(), 4), ids=lambda preset: preset.name)
def test_words_that_most_keys_share_are_not_of_their_names(preset, before, after):
    keys = [before + key + after for key in preset.keys]
    found = best_preset(["Basis", *keys])
    assert found is not None and found.name == preset.name
    wanted = {before + key + after for key in used(preset)}
    assert len(found.keys) >= 0.95 * len(wanted) and set(found.keys) <= set(keys)
    assert set(known_expressions([*keys, "Other"])) >= set(found.keys)


def test_words_that_only_some_keys_share_are_of_their_names():
    sided = [f"Move_{number}_{side}" for number in range(30) for side in ("L", "R")]
    assert known_expressions(sided) == [] and best_preset(sided) is None
    assert known_expressions(["Fat_Left", "Fat_jawOpen"]) == []


def test_a_mesh_with_other_keys_has_no_preset():
    keys = ["Fat", "Thin", "Old"]
    assert best_preset(keys) is None and expression_keys(keys) == keys
    assert expression_keys(["jaw_open", "Fat"]) == ["jaw_open"]


def test_a_table_adds_its_rows_within_slider_ranges():
    names = COEFFICIENTS
    table = KeyMap("mine", (KeyRow("jawOpen", "Open", 2.0, 0.1), KeyRow("mouthFunnel", "Open", 0.5)))
    coefficients = np.zeros((3, 52))
    coefficients[:, names.index("jawOpen")] = (0.0, 0.2, 1.0)
    coefficients[:, names.index("mouthFunnel")] = (0.0, 0.4, 0.0)
    values = table.apply(coefficients, {"Open": (0.0, 1.0)})
    np.testing.assert_allclose(values["Open"], (0.1, 0.7, 1.0))
    assert table.apply(coefficients, {}) == {}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"format": "other"}',
        '{"format": "facemime-key-map", "name": "x", "rows": [{"source": "jawDrop", "key": "a"}]}',
        '{"format": "facemime-key-map", "name": "x", "rows": [{"source": "jawOpen", "key": "a", "gain": NaN}]}',
    ],
)
def test_invalid_tables_are_refused(text, tmp_path):
    (tmp_path / "table.json").write_text(text)
    with pytest.raises(SourceError, match="not a key mapping"):
        load_map(tmp_path / "table.json")
    with pytest.raises(SourceError, match="cannot be read"):
        load_map(tmp_path / "none.json")


def test_gains_are_learnt_from_poses_and_undetermined_ones_stay():
    rng = np.random.default_rng(1)
    names = COEFFICIENTS
    columns = [names.index("jawOpen"), names.index("mouthPucker")]
    coefficients = np.zeros((6, 52))
    coefficients[:, columns] = rng.random((6, 2))
    poses = np.column_stack([1.5 * coefficients[:, columns[0]] + 0.5 * coefficients[:, columns[1]]])
    start = KeyMap("start", (KeyRow("browInnerUp", "Open", 0.7), KeyRow("jawOpen", "Other", 1.0)))
    learnt = learn_map(coefficients, poses, ["Open"], start)
    gains = {(row.source, row.key): row.gain for row in learnt.rows}
    assert gains["jawOpen", "Open"] == pytest.approx(1.5, abs=0.02)
    assert gains["mouthPucker", "Open"] == pytest.approx(0.5, abs=0.02)
    assert gains["browInnerUp", "Open"] == pytest.approx(0.7, abs=0.02)
    assert gains["jawOpen", "Other"] == 1.0 and min(gains.values()) > 0.0


def test_a_point_cache_contains_every_sample(tmp_path):
    samples = np.random.default_rng(0).random((4, 7, 3)).astype(np.float32)
    assert write_point_cache(tmp_path / "a.pc2", samples, 7, start=3.0) == 4
    data = (tmp_path / "a.pc2").read_bytes()
    assert struct.unpack("<12siiffi", data[:32]) == (b"POINTCACHE2\0", 1, 7, 3.0, 1.0, 4)
    assert np.array_equal(np.frombuffer(data[32:], "<f4").reshape(4, 7, 3), samples)


def test_a_failed_write_keeps_the_existing_point_cache(tmp_path):
    (tmp_path / "a.pc2").write_bytes(b"before")
    with pytest.raises(ValueError, match="shape"):
        write_point_cache(tmp_path / "a.pc2", [np.zeros((3, 3)), np.zeros((4, 3))], 3)
    assert (tmp_path / "a.pc2").read_bytes() == b"before" and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(OutputError):
        write_point_cache(tmp_path / "a.pc2" / "b.pc2", [], 3)


def test_values_are_interpolated_between_frames_and_held_beyond():
    times, values = np.array([1.0, 2.0, 4.0]), np.array([[0.0], [1.0], [5.0]])
    assert [float(in_between(times, values, at)[0]) for at in (0.0, 1.0, 1.5, 3.0, 4.0, 9.0)] == [0, 0, 0.5, 3, 5, 5]
