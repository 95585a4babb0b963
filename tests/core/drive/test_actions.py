"""Actions that no landmark shows: names, activations, and what they add to a head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.drive.actions import _MAX_ACTIVATION, TONGUE, ActionDriver
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.face.landmarks import LIPS, from_ibug, outer_eye_distance
from facemime.core.face.names import ACTION_MIRROR, ACTIONS, COEFFICIENTS, N_ACTIONS, action_indices
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from tests.helpers.parted_heads import with_parts
from tests.helpers.takes import performance

HEAD = built_in_head()
FACE = HEAD.vertices[HEAD.landmarks].astype(np.float64) / HEAD.eye_distance
TOLD_BY_PICTURE = np.array([not name.startswith("brow") for name in ACTIONS])
measured = arrays(np.float64, N_ACTIONS, elements=st.floats(-1.0, 2.0))


def showing(take: Take, **amounts: float) -> Take:
    """A take at rest in its first half and with the given actions in its second half."""
    actions = np.full((len(take), N_ACTIONS), 0.1, np.float32)
    for name, amount in amounts.items():
        actions[len(take) // 2 :, ACTIONS.index(name)] += amount
    actions[~take.found] = np.nan
    return replace(take, actions=actions)


def driver_of(take: Take, **options: object) -> HeadDriver:
    return HeadDriver(built_in_head(), calibrate(take), DriveSettings(**options))


def test_mirroring_actions_swaps_their_sides_and_twice_restores_them():
    np.testing.assert_array_equal(ACTION_MIRROR[ACTION_MIRROR], np.arange(N_ACTIONS))
    assert ACTIONS[ACTION_MIRROR[ACTIONS.index("cheekPuffLeft")]] == "cheekPuffRight"
    assert ACTION_MIRROR[TONGUE] == TONGUE
    with pytest.raises(ValueError):
        action_indices(["jawOpen"])


@given(measured, measured)
def test_activations_are_0_at_rest_grow_with_the_measurement_and_are_limited(rest, seen):
    driver = ActionDriver(rest, FACE)
    assert not driver.activations(rest.clip(0.0, 0.6), FACE).any()
    shown = driver.activations(seen, FACE)
    assert (shown >= 0.0).all() and (shown <= _MAX_ACTIVATION + 1e-9).all()
    assert (driver.activations(seen + 0.1, FACE) >= shown).all()


def test_a_full_action_is_shown_in_full_but_less_on_a_face_that_shows_some_of_it_at_rest():
    for rest, least in ((0.0, 1.0), (0.1, 1.0), (0.25, 0.1)):
        shown = ActionDriver(np.full(N_ACTIONS, rest), FACE).activations(np.ones(N_ACTIONS), FACE)
        assert (shown >= least * _MAX_ACTIVATION)[TOLD_BY_PICTURE].all()


def test_unknown_actions_show_nothing_and_an_unknown_rest_counts_as_none():
    unknown = np.full(N_ACTIONS, np.nan)
    assert not ActionDriver(np.zeros(N_ACTIONS), FACE).activations(unknown, FACE).any()
    shown = ActionDriver(unknown, FACE).activations(np.ones(N_ACTIONS), FACE)
    assert (shown >= _MAX_ACTIVATION)[TOLD_BY_PICTURE].all()


def test_a_brow_moves_in_full_when_image_and_landmarks_agree_and_less_otherwise():
    raised, still = FACE.copy(), FACE.copy()
    raised[from_ibug((20, 21)), 1] -= 0.06
    driver, seen = ActionDriver(np.zeros(N_ACTIONS), FACE), np.zeros(N_ACTIONS)
    seen[ACTIONS.index("browInnerUpRight")] = 1.0
    row = ACTIONS.index("browInnerUpRight")
    assert driver.activations(seen, raised)[row] >= 1.0
    half = driver.activations(seen, still)[row]
    assert half == pytest.approx(driver.activations(np.zeros(N_ACTIONS), raised)[row]) and 0.3 < half < 0.8
    assert not driver.activations(seen, still)[ACTIONS.index("browInnerUpLeft")]


def test_the_strength_of_a_region_multiplies_its_actions():
    seen = np.full(N_ACTIONS, 0.6)
    plain, scaled = (
        ActionDriver(np.zeros(N_ACTIONS), FACE, strength).activations(seen, FACE)
        for strength in ((1.0, 1.0, 1.0), (0.0, 1.0, 2.0))
    )
    brow, nose, lips = (ACTIONS.index(name) for name in ("browDownLeft", "noseSneerLeft", "mouthRollUpper"))
    np.testing.assert_allclose(scaled[[brow, nose, lips]], plain[[brow, nose, lips]] * (0.0, 1.0, 2.0))


def test_an_action_moves_the_skin_between_the_landmarks_and_not_the_landmarks():
    driver = driver_of(performance())
    rig, unit = driver.rig, outer_eye_distance(driver.rig.vertices[driver.rig.landmarks])
    moved = np.linalg.norm(driver.modes, axis=2) / unit
    whole = rig.landmarks[rig.region_weights.sum(axis=0)[rig.landmarks] > 0.99]
    assert len(whole) > 50 and moved[:, whole].max() < 2e-3
    assert not moved[:, ~rig.region_weights.any(axis=0)].any()
    for name in ("cheekPuffLeft", "cheekPuffRight"):
        assert moved[ACTIONS.index(name)].max() > 0.03
    assert not moved[TONGUE].any()


def test_a_puffed_cheek_moves_its_own_side_outwards():
    driver = driver_of(performance())
    for name, side in (("cheekPuffLeft", 1.0), ("cheekPuffRight", -1.0)):
        mode = driver.modes[ACTIONS.index(name)]
        most = np.argmax(np.linalg.norm(mode, axis=1))
        assert side * driver.rig.vertices[most, 0] > 0.0
        assert side * mode[most, 0] > 0.0


def test_a_take_that_shows_actions_puts_out_the_tongue_and_puffs_the_cheek():
    still = showing(performance())
    take = showing(still, tongueOut=0.9, cheekPuffLeft=0.9)
    motion, plain = (drive_take(driver_of(t), t) for t in (take, still))
    assert not motion.actions[: len(motion.times) // 2 - 1, TOLD_BY_PICTURE].any()
    assert motion.actions[-1, TONGUE] > 0.7
    added = np.linalg.norm(motion.vertices[-1] - plain.vertices[-1], axis=1)
    assert added.max() > 0.02 * outer_eye_distance(built_in_head().vertices[built_in_head().landmarks])


def test_only_landmarks_and_the_papers_kernels_ignore_actions():
    still = showing(performance())
    take = showing(still, tongueOut=0.9, cheekPuffLeft=0.9)
    motion, plain = (drive_take(driver_of(t, only_landmarks=True), t) for t in (take, still))
    np.testing.assert_array_equal(motion.vertices, plain.vertices)
    assert not motion.actions.any()
    assert driver_of(take, kernel="gaussian").modes is None


def test_measured_actions_become_the_arkit_coefficients_of_the_same_names():
    take = showing(performance(), tongueOut=0.9, cheekPuffLeft=0.9, cheekPuffRight=0.9)
    coefficients = arkit_coefficients(take, calibrate(take))[-1]
    named = dict(zip(COEFFICIENTS, coefficients, strict=True))
    assert named["tongueOut"] > 0.7 and named["cheekPuff"] > 0.8
    assert named["mouthPressLeft"] < 0.1 and named["mouthRollUpper"] < 0.1


def test_a_mirrored_head_shows_actions_on_the_other_side():
    take = showing(performance(), cheekPuffLeft=0.9)
    shown = driver_of(take, mirror=True).frame(take.result(len(take) - 1)).actions
    assert shown[ACTIONS.index("cheekPuffRight")] > 0.8 and shown[ACTIONS.index("cheekPuffLeft")] == 0.0


def test_a_tongue_that_is_a_part_comes_out_as_the_performer_sticks_it_out():
    rig, take = with_parts(), performance()
    driver = HeadDriver(rig, calibrate(take, start=0.0))
    rows, out = driver.parts.tongue
    assert len(rows) == len(load_head().part("tongue").vertices)
    still, shown = (
        driver.frame(replace(take.result(0), actions=amount * (np.arange(N_ACTIONS) == TONGUE)))
        for amount in (0.0, 1.0)
    )
    moved = np.asarray(shown.vertices) - still.vertices
    assert still.tongue == 0.0 and shown.tongue > 0.9
    np.testing.assert_allclose(moved[rows], shown.tongue * out, atol=1e-4 * rig.eye_distance)
    lips = rig.vertices[rig.landmarks[LIPS], 2].min()
    assert shown.vertices[rows, 2].min() < lips - 0.1 * rig.eye_distance
    assert np.abs(np.delete(moved, rows, axis=0)).max() < 1e-6
