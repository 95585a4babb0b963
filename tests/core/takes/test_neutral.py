"""The neutral face of a take is found where the performer rests, and estimated otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.errors import SourceError
from facemime.core.face.landmarks import (
    BROWS,
    EYE_CORNERS,
    LIPS,
    LOWER_LIDS,
    MIRROR,
    MOUTH_CORNERS,
    NOSE,
    UPPER_LIDS,
    eye_apertures,
    from_ibug,
    mouth_aperture,
)
from facemime.core.face.names import ACTIONS
from facemime.core.takes.face_space import FaceSpace, load_face_space, without_similarity
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.takes.rest import frowning
from facemime.core.takes.take import Take
from tests.helpers.takes import make_take

LOWER_INNER = from_ibug(range(65, 68))
FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def space() -> FaceSpace:
    return load_face_space()


def somebody(space: FaceSpace, seed: int) -> np.ndarray:
    """A random person's neutral face, (66, 3)."""
    weights = np.random.default_rng(seed).normal(size=len(space.identity))
    return np.asarray(space.mean + np.tensordot(weights, space.identity, 1))


def acting(face: np.ndarray, space: FaceSpace, seed: int, frames: int, restless: float = 0.0) -> np.ndarray:
    """Shapes (frames, 66, 3) with two expressions at a time that come and go, and at least `restless` of one always."""
    rng = np.random.default_rng(seed)
    shapes = np.tile(face, (frames, 1, 1)) + rng.normal(0.0, 0.003, (frames, *face.shape))
    for first in range(0, frames, 20):
        some = slice(first, first + 20)
        curve = np.maximum(restless, np.sin(np.linspace(0.0, np.pi, len(shapes[some]))))
        for unit in rng.choice(len(space.units), 2, replace=False):
            shapes[some] += curve[:, None, None] * space.units[unit]
    return shapes


def test_modes_and_units_neither_move_nor_turn_nor_scale_the_face(space: FaceSpace) -> None:
    for directions in (space.identity, space.units):
        left = without_similarity(directions, space.mean)
        np.testing.assert_allclose(left, directions, atol=2e-4)


def test_the_space_of_people_is_as_wide_for_a_face_as_for_its_mirror_image(space: FaceSpace) -> None:
    np.testing.assert_allclose((space.mean * FLIP)[MIRROR], space.mean, atol=1e-6)
    rows = space.identity.reshape(len(space.identity), -1)
    mirrored = (space.identity[:, MIRROR] * FLIP).reshape(rows.shape)
    np.testing.assert_allclose(mirrored.T @ mirrored, rows.T @ rows, atol=2e-4)


def at_rest(face: np.ndarray, space: FaceSpace) -> np.ndarray:
    """Estimate of a face that rests: half way to the mean as far as expressions lead there, with its own lips."""
    away = without_similarity((face - space.mean)[None], space.mean)[0]
    rest = face - 0.5 * space.expressed(away)
    eyes = away[EYE_CORNERS, 1].reshape(2, 2).mean(axis=1).repeat(5)
    rest[BROWS, 1] = face[BROWS, 1] - 0.5 * (away[BROWS, 1] - eyes)
    rest[NOSE[:4]], rest[EYE_CORNERS] = face[NOSE[:4]], face[EYE_CORNERS]
    rest[[*LIPS, *UPPER_LIDS, *LOWER_LIDS]] = np.nan
    return np.asarray(rest)


def test_expressions_that_last_are_told_from_what_tells_people_apart(space: FaceSpace) -> None:
    people = [without_similarity((somebody(space, seed) - space.mean)[None], space.mean)[0] for seed in range(20)]
    taken = [np.linalg.norm(space.expressed(person)) / np.linalg.norm(person) for person in people]
    missed = [np.linalg.norm(space.expressed(unit) - unit) / np.linalg.norm(unit) for unit in space.units]
    assert np.median(taken) < 0.6
    assert np.median(missed) < 0.2


def test_a_neutral_face_keeps_the_sockets_of_the_eyes_and_the_bridge_of_the_nose(space: FaceSpace) -> None:
    face = somebody(space, 5)
    neutral = calibrate(make_take(np.tile(face, (30, 1, 1))))
    np.testing.assert_allclose(neutral.shape[NOSE[:4]], face[NOSE[:4]], atol=0.005)
    np.testing.assert_allclose(neutral.shape[EYE_CORNERS], face[EYE_CORNERS], atol=0.005)


def test_the_neutral_face_lies_between_the_face_at_rest_among_expressions_and_the_mean(space: FaceSpace) -> None:
    away, estimated = [], []
    for seed in range(6):
        face = somebody(space, seed)
        neutral = calibrate(make_take(acting(face, space, seed, 160)))
        error = np.nan_to_num(neutral.shape - at_rest(face, space))
        away.append(np.abs(without_similarity(error[None], space.mean))[..., :2].mean())
        estimated.append(neutral.is_estimated)
    assert np.median(away) < 0.004
    assert sum(estimated) <= 1


@pytest.mark.thorough
def test_without_any_rest_the_neutral_face_is_still_nearer_than_that_of_half_of_the_frames(space: FaceSpace) -> None:
    nearer = []
    for seed in range(15):
        face = somebody(space, seed)
        shapes = acting(face, space, seed, 160, restless=0.7)
        neutral = calibrate(make_take(shapes))
        error = np.nan_to_num(neutral.shape - at_rest(face, space))
        away = np.abs(without_similarity(error[None], space.mean))[..., :2].mean()
        frames = np.abs(without_similarity(shapes - face, space.mean))[..., :2].mean(axis=(1, 2))
        nearer.append(away < 0.5 * np.median(frames))
    assert sum(nearer) >= 13


def smile_of(space: FaceSpace) -> np.ndarray:
    """The units that take each corner of the mouth farthest outwards, (66, 3)."""
    outwards = space.units[:, MOUTH_CORNERS, 0] * (-1.0, 1.0)
    return np.asarray(space.units[outwards.argmax(axis=0)].sum(axis=0))


def width(shape: np.ndarray) -> float:
    return float(np.ptp(shape[MOUTH_CORNERS, 0]))


def test_a_smile_that_lasts_for_the_whole_take_is_removed_and_reported(space: FaceSpace) -> None:
    smile, left = smile_of(space), []
    for seed in range(9):
        face = somebody(space, seed)
        neutral = calibrate(make_take(np.tile(face + smile, (80, 1, 1))))
        assert neutral.is_estimated
        left.append((width(neutral.shape) - width(face)) / (width(face + smile) - width(face)))
    assert np.median(left) < 0.15


def test_a_broad_mouth_that_rests_is_no_smile(space: FaceSpace) -> None:
    away = [without_similarity((somebody(space, seed) - space.mean)[None], space.mean)[0] for seed in range(40)]
    broad = sorted(away, key=lambda face: width(space.mean + face))[-10:]
    assert np.median([space.acting_probability(face) for face in broad]) < 0.2
    assert np.median([space.acting_probability(face + smile_of(space)) for face in away]) > 0.8


def test_lips_that_never_meet_in_a_take_rest_shut(space: FaceSpace) -> None:
    for seed in range(3):
        shapes = np.tile(somebody(space, seed) + smile_of(space), (80, 1, 1))
        shapes[:, LOWER_INNER, 1] += 0.12
        assert abs(float(mouth_aperture(calibrate(make_take(shapes)).shape))) < 0.01


def test_a_lasting_grin_is_not_taken_for_the_neutral_face(space: FaceSpace) -> None:
    shapes = np.tile(somebody(space, 7), (150, 1, 1))
    shapes[40:, MOUTH_CORNERS, 0] += (-0.1, 0.1)
    shapes[40:, LOWER_INNER, 1] += 0.1
    assert calibrate(make_take(shapes)).end <= 1.6


def test_an_open_mouth_raised_brows_and_shut_eyes_are_not_the_neutral_face(space: FaceSpace) -> None:
    face = somebody(space, 1)
    shapes = np.tile(face, (200, 1, 1))
    shapes[:60, LOWER_INNER, 1] += 0.2
    shapes[60:120, BROWS, 1] -= 0.08
    shapes[120:180, UPPER_LIDS, 1] += 0.08
    neutral = calibrate(make_take(shapes))
    assert neutral.start >= 7.2
    assert abs(mouth_aperture(neutral.shape) - mouth_aperture(face)) < 0.01
    assert np.abs(eye_apertures(neutral.shape) - eye_apertures(face)).max() < 0.01


def test_high_brows_are_the_persons_own_where_they_stay_high(space: FaceSpace) -> None:
    raised = [unit for unit in space.units[space.of_brows] if unit[BROWS, 1].mean() < -0.01]
    face = somebody(space, 4) + 0.8 * np.sum(raised, axis=0)
    found = calibrate(make_take(acting(face, space, 4, 400)))
    assert abs((found.shape - at_rest(face, space))[BROWS, 1].mean()) < 0.02


def knitting(face: np.ndarray, right: float, left: float) -> Take:
    """A take of a face whose brows are knitted by these activations throughout."""
    take = make_take(np.tile(face, (60, 1, 1)))
    take.actions[:] = 0.0
    take.actions[:, ACTIONS.index("browDownRight")] = right
    take.actions[:, ACTIONS.index("browDownLeft")] = left
    return take


def lowered(take: Take, neutral: Neutral) -> np.ndarray:
    """How far both brows are below those of the neutral face, (2,), in eye distances."""
    return np.asarray((take.shape[0] - neutral.shape)[BROWS, 1].reshape(2, 5).mean(axis=1))


def test_brows_that_are_certainly_knitted_throughout_are_shown_as_a_frown(space: FaceSpace) -> None:
    face = somebody(space, 8)
    frowns, doubtful = knitting(face, 0.97, 0.96), knitting(face, 0.97, 0.6)
    found, other = calibrate(frowns), calibrate(doubtful)
    assert (lowered(frowns, found) >= 0.0399).all()
    apart = [face[from_ibug((22,))[0], 0] - face[from_ibug((21,))[0], 0] for face in (found.shape, frowns.shape[0])]
    assert apart[0] - apart[1] >= 0.0399
    np.testing.assert_allclose(found.actions[[ACTIONS.index("browDownRight"), ACTIONS.index("browDownLeft")]], 0.0)
    # Everything else rests as if the brows' certainty were not there.
    rest = np.setdiff1d(np.arange(66), BROWS)
    np.testing.assert_allclose(found.shape[rest], other.shape[rest], atol=1e-9)
    assert other.actions[ACTIONS.index("browDownRight")] == pytest.approx(0.97)


@pytest.mark.parametrize(("down", "seen", "frowns"), [(0.03, 0.8, True), (-0.03, 0.8, False), (0.03, 0.6, False)])
def test_low_brows_that_seem_knitted_are_a_frown_and_high_ones_the_persons_own(space, down, seen, frowns) -> None:
    face = space.mean.copy()
    face[BROWS, 1] += down
    take = knitting(face, seen, seen)
    found = calibrate(take)
    own = found.actions[ACTIONS.index("browDownLeft")]
    assert own == pytest.approx(0.0 if frowns else seen, abs=1e-6)
    assert (lowered(take, found) >= 0.0399).all() == frowns


def test_low_brows_above_a_smile_are_no_frown(space: FaceSpace) -> None:
    smiles = space.mean.copy()
    smiles[BROWS, 1] += 0.03
    smiles[MOUTH_CORNERS] += [[-0.08, -0.06, 0.0], [0.08, -0.06, 0.0]]
    assert frowning(smiles, 0.8) < 0.05 < 0.95 < frowning(smiles, 1.0)


@pytest.mark.parametrize(("seen", "own"), [(0.2, 0.2), (0.8, 0.35)])
def test_a_nose_that_stays_strongly_wrinkled_is_not_the_persons_own(space: FaceSpace, seen, own) -> None:
    sneers = [ACTIONS.index("noseSneerRight"), ACTIONS.index("noseSneerLeft")]
    take = make_take(np.tile(somebody(space, 3), (60, 1, 1)))
    take.actions[:] = 0.0
    take.actions[:, sneers] = seen
    np.testing.assert_allclose(calibrate(take).actions[sneers], own, atol=1e-6)
    # Somebody who was asked to rest does.
    np.testing.assert_allclose(calibrate(take, start=0.0).actions[sneers], seen, atol=1e-6)


@given(st.floats(0.0, 1.0), st.floats(0.0, 0.1))
def test_the_frown_that_is_shown_grows_with_the_certainty_and_never_jumps(space: FaceSpace, one, more) -> None:
    face = somebody(space, 9)
    less, further = (knitting(face, certainty, certainty) for certainty in (one, min(one + more, 1.0)))
    grown = lowered(further, calibrate(further)) - lowered(less, calibrate(less))
    own = np.abs(lowered(knitting(face, 0.6, 0.6), calibrate(knitting(face, 0.6, 0.6))))
    assert (np.abs(grown) <= (own + 0.05) / 0.1 * more + 1e-6).all()


def test_half_shut_eyes_are_not_the_neutral_face(space: FaceSpace) -> None:
    face = somebody(space, 6)
    found = calibrate(make_take(acting(face, space, 6, 400, restless=0.3)))
    assert eye_apertures(found.shape).mean() > 0.95 * eye_apertures(face).mean()


def test_a_blink_within_a_given_second_does_not_half_close_the_eyes(space: FaceSpace) -> None:
    face = somebody(space, 2)
    shapes = np.tile(face, (25, 1, 1))
    shapes[10:15, UPPER_LIDS, 1] += 0.06
    np.testing.assert_allclose(calibrate(make_take(shapes), start=0.0).shape, face, atol=1e-6)


def test_lost_frames_are_skipped_and_a_take_without_a_face_is_refused(space: FaceSpace) -> None:
    shapes = np.tile(somebody(space, 4), (60, 1, 1))
    found = np.ones(60, bool)
    found[::2] = False
    shapes[::2] = np.nan
    assert np.isfinite(calibrate(make_take(shapes, found=found)).shape).all()
    with pytest.raises(SourceError, match="No face was found"):
        calibrate(make_take(shapes * np.nan, found=~np.ones(60, bool)))
    with pytest.raises(SourceError, match="between 90"):
        calibrate(make_take(shapes, found=found), start=90.0)


def test_a_head_that_is_turned_all_the_time_looks_away_unless_that_time_was_chosen(space: FaceSpace) -> None:
    pose = np.tile([100.0, 0.0, 0.7, 0.0, 320.0, 240.0], (60, 1))
    take = make_take(np.tile(somebody(space, 5), (60, 1, 1)), pose=pose)
    np.testing.assert_array_equal(calibrate(take).rotation, np.eye(3))
    chosen = calibrate(take, start=0.0).rotation
    assert np.degrees(np.arccos((np.trace(chosen) - 1.0) / 2.0)) == pytest.approx(np.degrees(0.7))


def test_a_calibration_of_an_earlier_version_is_read(space: FaceSpace) -> None:
    neutral = calibrate(make_take(np.tile(somebody(space, 6), (30, 1, 1))))
    stored = neutral.to_dict()
    del stored["removed"]
    read = Neutral.from_dict(stored)
    np.testing.assert_array_equal(read.shape, neutral.shape)
    assert replace(neutral, removed=0.0).removed == read.removed
