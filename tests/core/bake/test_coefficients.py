"""ARKit's coefficients are recognised, exclude each other, and stay sparse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from facemime.core.bake.arkit import Observer, _as_phones, _sealed, arkit_coefficients, coefficients_of
from facemime.core.bake.coefficients import N_OBSERVED, CoefficientModel, CoefficientSolver, load_coefficient_model
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.retarget import _LIP_GAIN
from facemime.core.errors import ModelError, SourceError
from facemime.core.face.landmarks import LIPS, LOWER_LIPS, MIRROR, N_LANDMARKS, UPPER_LIPS, outer_eye_distance
from facemime.core.face.names import (
    ACTION_MIRROR,
    COEFFICIENT_INDEX,
    COEFFICIENT_MIRROR,
    COEFFICIENTS,
    EXCLUSIVE,
    FITTED,
    N_ACTIONS,
)
from facemime.core.heads.built_in import load_head
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.takes import performance

AHEAD = np.tile(np.eye(3), (2, 1, 1))
SHAPE = 3 * N_LANDMARKS


@pytest.fixture(scope="module")
def solver() -> CoefficientSolver:
    return CoefficientSolver(load_coefficient_model())


def named(coefficients: np.ndarray) -> dict[str, float]:
    """Coefficients by name, (52,), or (44,) for the fitted ones."""
    names = COEFFICIENTS if len(coefficients) == len(COEFFICIENTS) else [COEFFICIENTS[k] for k in FITTED]
    return dict(zip(names, coefficients.tolist(), strict=True))


def built_in_face(amounts: dict[str, float]) -> tuple[np.ndarray, Neutral]:
    """The tracker's shape (66, 3) of the built-in head under its own units, and its neutral face."""
    head, model = load_head(), FaceTracker.load().pdm
    rest = head.vertices[head.landmarks].astype(np.float64)
    units = head.units[:, head.landmarks].astype(np.float64)
    moved = sum((amount * units[head.unit_names.index(name)] for name, amount in amounts.items()), np.zeros((66, 3)))
    scale = 100.0 / outer_eye_distance(rest)
    shapes = [model.shape(model.fit(scale * points[:, :2]).shape_params) for points in (rest, rest + moved)]
    pose = np.array([100.0, 0.0, 0.0])
    return shapes[1], Neutral(shapes[0], np.eye(3), pose, 0.0, 1.0, actions=np.zeros(N_ACTIONS))


def seen(shape: np.ndarray) -> TrackResult:
    """A tracking result with a shape, eyes that look ahead, and unknown actions."""
    pose = np.array([100.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return replace(performance().result(0), shape=shape, pose=pose, actions=np.full(N_ACTIONS, np.nan))


def found_on_the_built_in_head(amounts: dict[str, float], **options: object) -> dict[str, float]:
    shape, neutral = built_in_face(amounts)
    observed = Observer(neutral, DriveSettings(**options)).face(seen(shape))
    return named(CoefficientSolver(load_coefficient_model(), actions=False).frames(observed[None])[0])


@pytest.mark.parametrize(
    "name", ["jawOpen", "mouthSmile", "mouthPucker", "browInnerUp", "eyeBlink", "mouthLeft", "jawRight"]
)
def test_a_unit_of_the_built_in_head_is_found_by_its_name(name):
    sides = [name] if name in COEFFICIENT_INDEX else [name + "Left", name + "Right"]
    found = found_on_the_built_in_head(dict.fromkeys(sides, 0.85))
    assert min(found[side] for side in sides) > 0.4
    assert max(found, key=found.get) in sides


def test_a_smile_is_not_mistaken_for_a_dimple_a_shrug_or_a_sideways_mouth():
    shape, neutral = built_in_face({"mouthSmileLeft": 0.85, "mouthSmileRight": 0.85})
    away = shape - neutral.shape
    away[LIPS, :2] /= _LIP_GAIN  # as the tracker shows it
    observed = Observer(neutral, DriveSettings()).face(seen(neutral.shape + away))
    found = named(CoefficientSolver(load_coefficient_model(), actions=False).frames(observed[None])[0])
    assert min(found["mouthSmileLeft"], found["mouthSmileRight"]) > 0.5
    others = ("mouthDimpleLeft", "mouthDimpleRight", "mouthShrugLower", "mouthShrugUpper", "mouthLeft", "mouthRight")
    assert max(found[name] for name in others) < 0.3


def test_a_face_at_rest_has_no_coefficients(solver):
    assert not solver.frames(np.zeros((1, N_OBSERVED))).any()


@settings(max_examples=30)
@given(column=st.integers(0, len(FITTED) - 1), amount=st.floats(0.5, 0.9))
def test_the_observation_of_a_single_coefficient_yields_that_coefficient(column, amount):
    model = load_coefficient_model()
    solver = CoefficientSolver(replace(model, gains=np.ones(len(FITTED))))
    found = named(solver.frames(amount * model.responses[None, column])[0])
    name = COEFFICIENTS[FITTED[column]]
    sides = {name, COEFFICIENTS[COEFFICIENT_MIRROR[FITTED[column]]]}
    rivals = [value for other, value in found.items() if other not in sides]
    assert found[name] > max(rivals) or found[name] < 0.3 > max(rivals)  # found, or too faint to be told


@settings(max_examples=40)
@given(observed=arrays(np.float64, (3, N_OBSERVED), elements=st.floats(-1.0, 1.0)))
def test_coefficients_are_within_0_and_1_and_exclusive_ones_never_occur_together(observed):
    solver = CoefficientSolver(load_coefficient_model())
    for found in (solver.frames(observed), solver.take(observed)):
        assert np.isfinite(found).all() and found.min() >= 0.0 and found.max() <= 1.0
        whole = np.zeros((len(found), len(COEFFICIENTS)))
        whole[:, FITTED] = found
        assert whole[:, EXCLUSIVE].min(axis=2).max() < 2e-3


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_flipped_face_has_the_coefficients_of_the_other_side(seed):
    rng, model = np.random.default_rng(seed), load_coefficient_model()
    acted = rng.random((2, len(FITTED))) * (rng.random((2, len(FITTED))) < 0.1)
    observed = acted @ model.responses + rng.normal(0.0, 0.01, (2, N_OBSERVED))
    shape = observed[:, :SHAPE].reshape(-1, N_LANDMARKS, 3)[:, MIRROR] * [-1.0, 1.0, 1.0]
    flipped = np.concatenate([shape.reshape(2, -1), observed[:, SHAPE:][:, ACTION_MIRROR]], axis=1)
    whole = np.zeros((2, 2, len(COEFFICIENTS)))
    whole[0][:, FITTED], whole[1][:, FITTED] = (CoefficientSolver(model).frames(x) for x in (observed, flipped))
    np.testing.assert_allclose(whole[0], whole[1][:, COEFFICIENT_MIRROR], atol=0.02)


def test_a_fit_without_known_actions_is_not_corrected():
    model = load_coefficient_model()
    acted = np.random.default_rng(3).random((4, len(FITTED))) < 0.1
    observed = acted @ model.responses
    fitted = replace(model, correction=())
    alone, both = (CoefficientSolver(each, actions=False).frames(observed) for each in (fitted, model))
    np.testing.assert_array_equal(alone, both)
    assert np.abs(CoefficientSolver(fitted).frames(observed) - CoefficientSolver(model).frames(observed)).max() > 0.05


def test_a_frame_depends_only_on_itself(solver):
    observed = np.random.default_rng(2).normal(0.0, 0.05, (6, N_OBSERVED))
    alone = np.concatenate([solver.frames(row[None]) for row in observed])
    np.testing.assert_allclose(solver.frames(observed), alone, atol=1e-6)


def test_coefficients_do_not_depend_on_those_of_the_frame_before(solver):
    observed, near = np.random.default_rng(6).normal(0.0, 0.02, (12, N_OBSERVED)), np.zeros((1, len(FITTED)))
    in_turn = np.concatenate([solver.frames(row[None], near) for row in observed])
    assert near.any()
    np.testing.assert_allclose(in_turn, solver.frames(observed), atol=1e-6)


def test_a_take_is_corrected_for_the_error_of_its_neutral_face(solver):
    model = load_coefficient_model()
    wrong = model.neutral.modes[0] * 1.5
    smile = [np.flatnonzero(COEFFICIENT_INDEX[f"mouthSmile{side}"] == FITTED)[0] for side in ("Left", "Right")]
    acted = np.zeros((60, len(FITTED)))
    acted[40:, smile] = 0.8
    found = solver.take(acted @ model.responses + wrong)
    assert np.abs(found[:40]).max() < 0.1 and found[40:, smile].min() > 0.6


@pytest.mark.parametrize("count", [1, 3, 60])
def test_a_lasting_smile_is_not_taken_for_an_error_of_the_neutral_face(solver, count):
    smile = [np.flatnonzero(COEFFICIENT_INDEX[f"mouthSmile{side}"] == FITTED)[0] for side in ("Left", "Right")]
    acted = np.zeros((count, len(FITTED)))
    acted[:, smile] = 0.8
    assert solver.take(acted @ load_coefficient_model().responses)[:, smile].min() > 0.5


def test_frames_without_known_actions_are_found_by_their_landmarks():
    take = performance()
    unknown = replace(take, actions=np.full_like(take.actions, np.nan))
    found = arkit_coefficients(unknown, calibrate(unknown, start=0.0))
    assert found.shape == (int(take.found.sum()), len(COEFFICIENTS))
    assert found[:, COEFFICIENT_INDEX["jawOpen"]].max() > 0.2


def test_simultaneous_coefficients_are_all_found(solver):
    together = {"jawOpen": 0.6, "browInnerUp": 0.7, "browOuterUpLeft": 0.7, "browOuterUpRight": 0.7, "mouthLeft": 0.6}
    acted = np.array([[together.get(COEFFICIENTS[k], 0.0) for k in FITTED]])
    found = named(solver.frames(acted @ load_coefficient_model().responses)[0])
    assert all(found[name] == pytest.approx(amount, abs=0.2) for name, amount in together.items())
    assert max(value for name, value in found.items() if name not in together) < 0.3


def test_lips_that_are_seen_closed_over_an_open_jaw_are_closed(solver):
    acted = np.array([[0.5 * (COEFFICIENTS[k] == "jawOpen") for k in FITTED]])
    observed = acted @ load_coefficient_model().responses
    moved = observed[0, : 3 * N_LANDMARKS].reshape(N_LANDMARKS, 3)
    gap = moved[LOWER_LIPS, 1].mean() - moved[UPPER_LIPS, 1].mean()
    assert named(solver.frames(observed)[0])["mouthClose"] < 0.05
    moved[LOWER_LIPS, 1] -= 0.5 * gap
    moved[UPPER_LIPS, 1] += 0.5 * gap
    found = named(solver.frames(observed)[0])
    assert found["jawOpen"] > 0.25 and found["mouthClose"] == pytest.approx(found["jawOpen"], abs=0.1)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), gap=st.floats(-0.02, 0.2))
def test_what_little_opens_lips_that_are_seen_shut_is_removed_and_parted_lips_are_left(seed, gap):
    rng = np.random.default_rng(seed)
    found = rng.uniform(0.0, 0.3, (5, len(FITTED)))
    jaw, closes = (FITTED.tolist().index(COEFFICIENT_INDEX[name]) for name in ("jawOpen", "mouthClose"))
    found[:, closes] = np.minimum(found[:, closes], found[:, jaw])
    driven = np.zeros((5, SHAPE))
    driven.reshape(5, N_LANDMARKS, 3)[:, LOWER_LIPS, 1] = gap
    sealed = _sealed(found.copy(), driven)
    assert (sealed >= 0.0).all() and (sealed <= 1.0).all() and (sealed[:, closes] <= sealed[:, jaw] + 1e-9).all()
    without = np.arange(len(FITTED)) != closes
    assert (sealed[:, without] <= found[:, without]).all()
    head = load_head()
    units = head.units[FITTED][:, head.landmarks].astype(float) / outer_eye_distance(head.vertices[head.landmarks])
    apart = (units[:, LOWER_LIPS, 1].mean(axis=1) - units[:, UPPER_LIPS, 1].mean(axis=1)) @ sealed.T
    if gap <= 0.03:
        assert (apart < max(gap, 0.0) + 0.02).all()
    if gap >= 0.08:
        np.testing.assert_allclose(sealed, found, atol=1e-12)


def test_coefficients_are_at_least_the_measured_actions():
    shown = np.zeros((1, N_ACTIONS))
    shown[0, 0] = 0.9
    found = named(coefficients_of(np.zeros((1, N_OBSERVED)), np.zeros((1, SHAPE)), AHEAD[None], shown)[0])
    assert found["tongueOut"] == 0.9 and sum(found.values()) == pytest.approx(0.9)


def test_strength_and_mirror_apply_to_coefficients():
    closed = found_on_the_built_in_head({"jawOpen": 0.8}, strength_lower=0.0, strength_middle=0.0)
    assert closed["jawOpen"] < 0.05
    right = found_on_the_built_in_head({"mouthSmileRight": 0.8})
    assert right["mouthSmileRight"] > 0.4 > right["mouthSmileLeft"] + 0.2
    shape, neutral = built_in_face({"mouthSmileRight": 0.8})
    observer = Observer(neutral, DriveSettings(mirror=True))
    observed = observer.face(observer.mirrored(seen(shape)))
    left = named(CoefficientSolver(load_coefficient_model(), actions=False).frames(observed[None])[0])
    assert left["mouthSmileLeft"] == pytest.approx(right["mouthSmileRight"], abs=0.1)


def test_a_take_without_a_face_has_no_coefficients():
    take = performance()
    with pytest.raises(SourceError):
        arkit_coefficients(replace(take, found=np.zeros(len(take), bool)), calibrate(take))


def test_a_damaged_model_is_refused(tmp_path):
    (tmp_path / "model.npz").write_bytes(b"not a model")
    for path in (tmp_path / "model.npz", tmp_path / "missing.npz"):
        with pytest.raises(ModelError):
            load_coefficient_model(path)


def test_the_covariances_of_the_model_are_positive():
    model: CoefficientModel = load_coefficient_model()
    for spread in (model.frame, model.neutral):
        assert np.linalg.eigvalsh(spread.matrix()).min() > 0.0
    assert np.linalg.eigvalsh(model.together).min() > 0.0


def test_raised_brows_have_the_amplitude_that_phones_mean_and_other_coefficients_that_of_the_model(solver):
    inner, rows = COEFFICIENT_INDEX["browInnerUp"], FITTED.tolist()
    observed = load_coefficient_model().responses[rows.index(inner)] * [[0.5], [1.5]]
    own = solver.take(observed)
    stated = _as_phones(own)
    brow = own[:, rows.index(inner)]
    np.testing.assert_allclose(stated[:, rows.index(inner)], brow * (0.54 + 0.46 * brow))
    others = [i for i, k in enumerate(rows) if not COEFFICIENTS[k].startswith(("browInner", "browOuter"))]
    np.testing.assert_allclose(stated[:, others], own[:, others])
