"""Coefficients are brought nearer to what makes a head look as the driven one does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.likeness import _LOWER, _UPPER, alike
from facemime.core.face.landmarks import LOWER_LIDS, LOWER_LIPS, N_LANDMARKS, UPPER_LIDS, UPPER_LIPS, outer_eye_distance
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENT_MIRROR, COEFFICIENTS, EXCLUSIVE
from facemime.core.heads.built_in import landmarks_at_rest, load_head

FITTED_BY_LOOKS = np.array([name.startswith((*_UPPER, *_LOWER)) for name in COEFFICIENTS])


@pytest.fixture(scope="module")
def units() -> np.ndarray:
    """Motions of the built-in head's landmarks at 1, (52, 198), in outer-eye distances."""
    head = load_head()
    every = head.units[:, head.landmarks].astype(np.float64) / outer_eye_distance(landmarks_at_rest())
    return every.reshape(len(every), -1)


def acted(**amounts: float) -> np.ndarray:
    """Coefficients (1, 52)."""
    out = np.zeros((1, len(COEFFICIENTS)))
    for name, amount in amounts.items():
        out[0, COEFFICIENT_INDEX[name]] = amount
    return out


def opening(moved: np.ndarray) -> np.ndarray:
    """Opening of the right and the left eye (2,) relative to rest, for displacements (198,)."""
    rest = landmarks_at_rest()
    rest /= outer_eye_distance(rest)
    shown = rest + moved.reshape(N_LANDMARKS, 3)
    gaps = [(face[LOWER_LIDS, 1] - face[UPPER_LIDS, 1]).reshape(2, 2).mean(axis=1) for face in (shown, rest)]
    return np.asarray(gaps[0] / gaps[1])


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_coefficients_that_look_right_already_stay(units, seed):
    rng = np.random.default_rng(seed)
    found = rng.uniform(0.0, 0.6, (3, len(COEFFICIENTS))) * (rng.random((3, len(COEFFICIENTS))) < 0.2)
    found[:, EXCLUSIVE[:, 1]] = 0.0
    found[:, COEFFICIENT_INDEX["mouthClose"]] = 0.0
    looked = alike(found, found @ units)
    blinks = [COEFFICIENT_INDEX[name] for name in ("eyeBlinkLeft", "eyeBlinkRight")]
    assert (looked[:, blinks] >= found[:, blinks] - 1e-3).all()
    others = np.setdiff1d(np.arange(len(COEFFICIENTS)), blinks)
    np.testing.assert_allclose(looked[:, others], found[:, others], atol=1e-3)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_opposites_exclude_each_other_and_what_landmarks_do_not_show_stays(units, seed):
    rng = np.random.default_rng(seed)
    found = rng.uniform(0.0, 1.0, (3, len(COEFFICIENTS)))
    found[:, EXCLUSIVE[np.arange(len(EXCLUSIVE)), rng.integers(0, 2, len(EXCLUSIVE))]] = 0.0
    looked = alike(found, rng.normal(0.0, 0.05, (3, units.shape[1])))
    assert (looked >= 0.0).all() and (looked <= 1.0).all()
    fitted = EXCLUSIVE[FITTED_BY_LOOKS[EXCLUSIVE].all(axis=1)]
    assert looked[:, fitted].min(axis=2).max() == 0.0
    assert (looked[:, COEFFICIENT_INDEX["mouthClose"]] <= looked[:, COEFFICIENT_INDEX["jawOpen"]]).all()
    np.testing.assert_array_equal(looked[:, ~FITTED_BY_LOOKS], found[:, ~FITTED_BY_LOOKS])


@pytest.mark.parametrize("missed", [0.0, 0.4, 0.7])
@pytest.mark.parametrize("side", ["Left", "Right"])
def test_an_eye_that_is_seen_shut_is_shut_whatever_was_found(units, side, missed):
    name = f"eyeBlink{side}"
    looked = alike(acted(**{name: missed}), acted(**{name: 1.0}) @ units)
    assert looked[0, COEFFICIENT_INDEX[name]] == pytest.approx(1.0)
    shut = opening(looked[0] @ units)
    this, other = (1, 0) if side == "Left" else (0, 1)
    assert shut[this] < 0.05 and shut[other] > 0.9


@pytest.mark.parametrize(
    "name", ["browOuterUpLeft", "browInnerUp", "browDownRight", "mouthSmileLeft", "mouthPucker", "jawOpen"]
)
def test_a_motion_that_was_missed_is_shown_in_part_by_its_own_coefficient(units, name):
    moved = acted(**{name: 0.6}) @ units
    looked = alike(acted(), moved)
    left = np.linalg.norm(moved - looked @ units) / np.linalg.norm(moved)
    assert left < 0.7
    assert looked[0].argmax() == COEFFICIENT_INDEX[name]


def test_a_smile_that_is_seen_to_be_a_frown_becomes_one(units):
    looked = alike(acted(mouthSmileLeft=0.15), acted(mouthFrownLeft=0.8) @ units)
    smile, frown = (looked[0, COEFFICIENT_INDEX[name]] for name in ("mouthSmileLeft", "mouthFrownLeft"))
    assert smile == 0.0 < frown


@pytest.mark.parametrize("amount", [0.6, 1.5])
def test_lips_that_part_over_clenched_teeth_open_the_jaw_less_than_a_jaw_that_drops(units, amount):
    lips = {f"mouth{lip}{side}": 1.0 for lip in ("UpperUp", "LowerDown") for side in ("Left", "Right")}
    parted = alike(acted(), amount * acted(**lips) @ units)
    # A jaw that parts the lips as far takes the chin along.
    opened = alike(acted(), acted(jawOpen=0.25 * amount) @ units)
    jaw = COEFFICIENT_INDEX["jawOpen"]
    assert parted[0, jaw] < 0.8 * opened[0, jaw]
    assert parted[0, COEFFICIENT_INDEX["mouthUpperUpLeft"]] > 3.0 * opened[0, COEFFICIENT_INDEX["mouthUpperUpLeft"]]


@pytest.mark.parametrize("amount", [0.2, 0.5])
def test_jaws_whose_teeth_are_shut_open_less_and_the_lips_part_without_them(units, amount):
    jaw, moved = COEFFICIENT_INDEX["jawOpen"], acted(jawOpen=amount) @ units
    loose, unknown, half, shut = (
        alike(acted(jawOpen=amount), moved, teeth)[0]
        for teeth in (None, np.array([np.nan]), np.array([0.5]), np.array([1.0]))
    )
    np.testing.assert_array_equal(unknown, loose)
    assert half[jaw] == pytest.approx(0.625 * loose[jaw]) and shut[jaw] == pytest.approx(0.25 * loose[jaw])
    assert lip_gap(shut @ units) > 0.5 * lip_gap(loose @ units)
    rounded = [COEFFICIENT_INDEX["mouthFunnel"], COEFFICIENT_INDEX["mouthPucker"]]
    assert (shut[rounded] <= loose[rounded]).all()


def lip_gap(moved: np.ndarray) -> float:
    """How far displacements (198,) part the inner lips."""
    landmarks = moved.reshape(-1, 3)
    return float((landmarks[LOWER_LIPS, 1] - landmarks[UPPER_LIPS, 1]).mean())


def test_a_flipped_face_has_the_coefficients_of_the_other_side(units):
    one = alike(acted(), acted(browOuterUpLeft=0.5, mouthSmileLeft=0.5) @ units)
    other = alike(acted(), acted(browOuterUpRight=0.5, mouthSmileRight=0.5) @ units)
    np.testing.assert_allclose(one[:, COEFFICIENT_MIRROR], other, atol=0.03)
