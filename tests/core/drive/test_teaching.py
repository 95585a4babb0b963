"""Corrections that are taught by examples: exact at these, nothing at rest, and fading with the distance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.arkit import FrameCoefficients
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.drive.teaching import (
    Interpolation,
    TaughtKeys,
    counting,
    require_expression,
    same_expression,
    suggest_frames,
)
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import BROWS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_map import KeyMap, KeyRow
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.heads.style import N_FEATURES, Example, Style
from facemime.core.puppet.outputs import HeadDrivers, KeyDriver, LiveHead, LiveKeys
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from facemime.core.tracking.result import TrackResult
from tests.helpers.parted_heads import with_parts
from tests.helpers.takes import performance

CENTRES = st.integers(1, 10).flatmap(
    lambda count: st.lists(
        st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4), min_size=count, max_size=count, unique_by=tuple
    )
)
PUSHED = 1e-3
"""Share of the eye distance by which lids may be pushed out of the eyeballs."""


def apart(centres: np.ndarray, least: float = 0.1) -> np.ndarray:
    """Those of `centres` that are neither near rest nor near an earlier one, in the space of expressions."""
    kept = [np.zeros(centres.shape[1])]
    for centre in centres:
        if min(np.linalg.norm(centre - at) for at in kept) > least:
            kept.append(centre)
    return np.pad(np.array(kept[1:]).reshape(-1, centres.shape[1]), ((0, 0), (0, N_FEATURES - centres.shape[1])))


@given(CENTRES)
@settings(max_examples=50, deadline=None)
def test_weights_are_one_and_zero_at_the_examples_and_zero_at_rest(centres):
    expressions = apart(np.array(centres))
    interpolation = Interpolation(expressions)
    for row, expression in zip(np.eye(len(expressions)), expressions, strict=True):
        np.testing.assert_allclose(interpolation.weights(expression), row, atol=1e-5)
    np.testing.assert_allclose(interpolation.weights(np.zeros(N_FEATURES)), 0.0, atol=1e-5)


@given(CENTRES)
@settings(max_examples=50, deadline=None)
def test_corrections_fade_far_from_all_examples(centres):
    expressions = apart(np.array(centres))
    far = np.full(N_FEATURES, 3.0)
    assert np.abs(Interpolation(expressions).weights(far)).max(initial=0.0) < 1e-3


def test_many_examples_along_one_motion_do_not_overshoot():
    motion = np.zeros((10, N_FEATURES))
    motion[:, 0] = np.linspace(0.1, 1.0, 10)
    interpolation = Interpolation(motion)
    amounts = [np.abs(interpolation.weights(at * motion[-1])).sum() for at in np.linspace(0.0, 1.3, 200)]
    assert max(amounts) < 6.0 and max(amounts[:150]) < 2.0


def test_a_correction_grows_smoothly_from_rest_to_its_only_example_and_then_fades():
    example = np.zeros((1, N_FEATURES))
    example[0, 0] = 0.5
    interpolation = Interpolation(example)
    weights = np.array([interpolation.weights(at * example[0])[0] for at in np.linspace(0.0, 8.0, 81)])
    top = int(weights.argmax())
    assert (np.diff(weights[: top + 1]) > 0.0).all() and (np.diff(weights[top:]) < 0.0).all()
    assert weights[5] == pytest.approx(0.5, abs=0.15) and weights[top] < 1.3 and weights[-1] < 0.05


@cache
def prepared(mirror: bool = False) -> tuple[HeadRig, Take, HeadDriver]:
    """The built-in head, a take, and its driver."""
    rig, take = built_in_head(lashes=True), performance()
    return rig, take, HeadDriver(rig, calibrate(take, 0.0), DriveSettings(mirror=mirror))


def bump(rig: HeadRig, landmark: int, size: float) -> np.ndarray:
    """A push towards the viewer around a landmark, in eye distances."""
    away = np.linalg.norm(rig.all_vertices - rig.vertices[rig.landmarks[landmark]], axis=1) / rig.eye_distance
    push = np.zeros((len(away), 3), np.float32)
    push[:, 2] = -size * rig.eye_distance * np.where(away < 0.4, np.cos(away / 0.4 * np.pi / 2) ** 2, 0.0)
    return push


def taught(driver: HeadDriver, result: TrackResult, edit: np.ndarray) -> HeadDriver:
    """The driver after it was taught a frame."""
    shown = driver.frame(result)
    example = Example("", "", driver.expression(result), driver.offsets(shown, shown.vertices + edit))
    style = Style((*driver.rig.style.examples, example))
    return HeadDriver(replace(driver.rig, style=style), calibrate(performance(), 0.0), driver.options, reuse=driver)


@pytest.mark.parametrize("mirror", [False, True])
def test_a_head_looks_as_it_was_taught_in_every_example_and_is_unchanged_at_rest(mirror):
    rig, take, plain = prepared(mirror)
    driver, wanted = plain, {}
    for number, frame in enumerate((34, 38, 44, 50)):
        edit = bump(rig, (8, 33, 57, 20)[number], 0.1)
        wanted[frame] = driver.frame(take.result(frame)).vertices + edit
        driver = taught(driver, take.result(frame), edit)
        assert driver.deformer is plain.deformer, "a style needs no other deformer"
    assert len(driver.frame(take.result(34)).taught) == 4
    for frame, vertices in wanted.items():
        away = np.abs(driver.frame(take.result(frame)).vertices - vertices)[: len(rig.vertices)].max()
        assert away < PUSHED * rig.eye_distance
    at_rest = take.result(5)
    difference = np.abs(driver.frame(at_rest).vertices - plain.frame(at_rest).vertices).max()
    assert difference < 1e-5 * rig.eye_distance


def test_lashes_follow_a_taught_lid_unless_they_were_moved_themselves():
    rig, take, plain = prepared()
    result = take.result(44)
    skin = np.arange(len(rig.all_vertices)) < len(rig.vertices)
    brow = int(BROWS[2])
    edit = bump(rig, brow, 0.1)
    ridden = taught(plain, result, edit * skin[:, None]).frame(result).vertices - plain.frame(result).vertices
    assert np.abs(ridden[~skin]).max() > 0.05 * rig.eye_distance
    moved = np.where(skin[:, None], 0.0, 2.0 * edit).astype(np.float32)
    own = taught(plain, result, moved).frame(result).vertices - plain.frame(result).vertices
    np.testing.assert_allclose(own, moved, atol=1e-5 * rig.eye_distance)


def test_lids_that_were_taught_into_an_eye_stay_outside():
    rig = with_parts()
    take = performance()
    plain = HeadDriver(rig, calibrate(take, 0.0))
    result = take.result(44)
    lid = rig.landmarks[38]
    edit = np.zeros_like(plain.rest)
    edit[lid, 2] = 0.1 * rig.eye_distance
    vertex = taught(plain, result, edit).frame(result).vertices[lid]
    eye = rig.eyeballs[np.linalg.norm(rig.eyeballs[:, :3] - vertex, axis=1).argmin()]
    at_rest = np.linalg.norm(plain.rest[lid] - eye[:3])
    assert np.linalg.norm(vertex - eye[:3]) > min(eye[3], at_rest) - 1e-3 * rig.eye_distance


def test_planar_heads_are_corrected_as_well():
    rig, take = built_in_head(), performance()
    plain = HeadDriver(rig, calibrate(take, 0.0), DriveSettings(mode="planar"))
    result = take.result(44)
    edit = bump(rig, 8, 0.1)
    corrected = taught(plain, result, edit).frame(result).vertices - plain.frame(result).vertices
    np.testing.assert_allclose(corrected, edit, atol=1e-5 * rig.eye_distance)


def test_a_motion_and_the_heads_of_a_session_have_the_correction():
    rig, take, plain = prepared()
    driver = taught(plain, take.result(44), bump(rig, 8, 0.1))
    assert np.abs(drive_take(driver, take).vertices - drive_take(plain, take).vertices).max() > 0.09 * rig.eye_distance
    drivers, neutral = HeadDrivers(), calibrate(take, 0.0)
    ((first,), _) = drivers.drive((LiveHead(rig),), neutral, take.result(44))
    ((second,), _) = drivers.drive((LiveHead(driver.rig),), neutral, take.result(44))
    assert np.abs(second.vertices - first.vertices).max() > 0.09 * rig.eye_distance
    assert drivers.drivers[0].deformer is not None and len(second.taught) == 1


def test_weight_scales_a_correction_and_muted_examples_do_not_count():
    rig, take, plain = prepared()
    result, edit = take.result(44), bump(rig, 8, 0.1)
    (example,) = taught(plain, result, edit).rig.style.examples

    def corrected(*examples):
        driver = HeadDriver(replace(rig, style=Style(examples)), plain.neutral, plain.options, reuse=plain)
        return driver.frame(result).vertices - plain.frame(result).vertices

    np.testing.assert_allclose(corrected(replace(example, weight=0.5)), edit / 2.0, atol=1e-5 * rig.eye_distance)
    assert not corrected(replace(example, muted=True)).any()


def test_of_two_examples_with_the_same_expression_the_later_counts_and_none_at_rest():
    expression = np.zeros(N_FEATURES)
    expression[3] = 0.3
    examples = [Example(str(number), "", at * expression, keys={"a": 1.0}) for number, at in enumerate((1, 1.02, 0.01))]
    assert [example.name for example in counting(Style(tuple(examples)), lambda example: True)] == ["1"]
    assert same_expression(Style(tuple(examples)), expression) == 1
    assert same_expression(Style(), expression) is None
    with pytest.raises(HeadError, match="at rest in this frame"):
        require_expression(0.01 * expression)


def test_an_example_of_another_mesh_is_refused_unless_keys_were_taught():
    rig, take, plain = prepared()
    expression = plain.expression(take.result(44))
    wrong = Example("Smile", "", expression, np.ones((7, 3), np.float32))
    with pytest.raises(HeadError, match="Smile was taught on a mesh with 7 vertices"):
        HeadDriver(replace(rig, style=Style((wrong,))), plain.neutral, reuse=plain)
    both = replace(wrong, keys={"jawOpen": 0.1})
    driver = HeadDriver(replace(rig, style=Style((both,))), plain.neutral, reuse=plain)
    assert len(driver.frame(take.result(44)).taught) == 0


def test_the_values_of_keys_are_corrected_within_their_ranges():
    head, (_, take, plain) = load_head(), prepared()
    result, unit = take.result(44), head.units[head.unit_names.index("jawOpen")]
    style = Style((Example("", "", plain.expression(result), keys={"jawOpen": 0.2, "Dimple": 0.9, "gone": 1.0}),))
    ranges = {"jawOpen": (0.0, 1.0), "Dimple": (0.0, 1.0)}
    table = KeyMap("", (KeyRow("jawOpen", "jawOpen", 1.0, 0.0),))
    rig = replace(built_in_head(), style=style)
    keys = LiveKeys(table, {name: np.asarray(unit, np.float32) for name in ranges}, ranges, {"Dimple": 0.3})
    driver = KeyDriver(HeadDriver(rig, calibrate(take, 0.0)), calibrate(take, 0.0), keys)
    jaw = table.apply(FrameCoefficients(calibrate(take, 0.0), DriveSettings()).of(result)[None], ranges)["jawOpen"][0]
    frame = driver.frame(result)
    np.testing.assert_allclose(frame.keys, [jaw + 0.2, 1.0], atol=1e-6)
    np.testing.assert_allclose(frame.vertices, driver.head.rest + frame.keys.sum() * unit, atol=1e-5)
    np.testing.assert_allclose(driver.frame(take.result(5)).keys[1], 0.3, atol=1e-6)
    assert TaughtKeys(Style()).changes(plain.expression(result)) == {}


def test_the_frames_that_are_suggested_are_the_most_different_and_never_like_those_taught():
    expressions = np.zeros((200, N_FEATURES))
    expressions[50:120, 0], expressions[120:150, 1], expressions[150:153, 2] = 0.5, 0.5, 0.5
    doubts = np.zeros(200)
    chosen = suggest_frames(expressions, doubts, [], 10)
    assert [int(np.flatnonzero(expressions[row])[0]) for row in chosen] == [0, 1, 2]
    assert suggest_frames(expressions, doubts, [expressions[60], expressions[130]], 10).tolist() == [150]
    doubts[120:150] = 1.0
    expressions[100:120] = 0.0
    assert 120 <= suggest_frames(expressions, doubts, [], 1)[0] < 150
    assert len(suggest_frames(expressions[:40], doubts[:40], [], 3)) == 0
