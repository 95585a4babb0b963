"""The performer is learnt during a live session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facemime.core.drive.posing import EyeDriver
from facemime.core.face.landmarks import eye_apertures, from_ibug
from facemime.core.puppet.learning import PerformerLearner
from facemime.core.takes.face_space import load_face_space
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.takes.take import Take
from tests.helpers.takes import make_take
from tests.helpers.thorough import first_of

FPS = 15.0
UPPER_LIDS, LOWER_LIDS = from_ibug((37, 38, 43, 44)), from_ibug((41, 40, 47, 46))


def person(seed: int = 3) -> np.ndarray:
    """A random person's neutral face, (66, 3)."""
    space = load_face_space()
    weights = np.random.default_rng(seed).normal(size=len(space.identity))
    return np.asarray(space.mean + np.tensordot(0.7 * weights, space.identity, 1))


def performing(face: np.ndarray, seconds: float, first: int | None = None) -> Take:
    """A take with occasional expressions, from the start if `first` is the number of one."""
    space, rng = load_face_space(), np.random.default_rng(5)
    count = round(seconds * FPS)
    shapes = np.tile(face, (count, 1, 1)) + rng.normal(0.0, 0.002, (count, 66, 3))
    for start in range(0, count, 60):
        unit = first if start == 0 and first is not None else int(rng.integers(len(space.units)))
        some = shapes[start : start + 30]
        some += np.sin(np.linspace(0.5 * np.pi, np.pi, len(some)))[:, None, None] * space.units[unit]
    return make_take(shapes, FPS)


def blinking(face: np.ndarray, seconds: float, left: float) -> Take:
    """A take at rest with a blink every two seconds, in which `left` of the opening remains."""
    shapes = np.tile(face, (round(seconds * FPS), 1, 1))
    for start in range(20, len(shapes) - 3, 30):
        gap = shapes[start : start + 3, LOWER_LIDS] - shapes[start : start + 3, UPPER_LIDS]
        shapes[start : start + 3, UPPER_LIDS] += (1.0 - left) * gap
    return make_take(shapes, FPS)


def learn(learner: PerformerLearner, take: Take, since: float = 0.0) -> Neutral:
    for frame, time in enumerate(take.times.tolist()):
        learner.add(since + time, take.result(frame))
    return learner.neutral


def first_second(take: Take) -> Neutral:
    return calibrate(take.part(take.times < 1.0))


def at_rest(face: np.ndarray) -> np.ndarray:
    """Neutral face (66, 3) of a take that shows a face at rest only."""
    return calibrate(make_take(np.tile(face, (15, 1, 1)), FPS)).shape


def off(neutral: Neutral, face: np.ndarray) -> float:
    return float(np.linalg.norm(neutral.shape - face, axis=1).mean())


@pytest.mark.parametrize("unit", first_of([0, 7, 21]))
def test_a_performer_who_starts_with_an_expression_soon_has_a_neutral_face(unit):
    face = person()
    take = performing(face, 24.0, first=unit)
    start = replace(first_second(take), shape=take.shape[:15].astype(float).mean(axis=0))
    assert off(learn(PerformerLearner(start), take), at_rest(face)) < 0.5 * off(start, at_rest(face))


def test_where_eyes_are_shut_is_learnt_from_blinks_without_a_request():
    take = blinking(person(), 12.0, 0.25)
    start = first_second(take)
    learnt = learn(PerformerLearner(start), take)
    assert start.shut == 0.0 and learnt.shut == pytest.approx(0.25, abs=0.05)


def test_half_shut_eyes_are_not_a_blink():
    take = blinking(person(), 12.0, 0.6)
    assert learn(PerformerLearner(first_second(take)), take).shut == 0.0


def test_a_calibrated_neutral_face_keeps_its_shape_and_learns_the_lids():
    face = person()
    asked = replace(calibrate(blinking(face, 4.0, 0.3), 0.0, 1.0), shut=0.0)
    learner = PerformerLearner(asked)
    learn(learner, performing(face, 8.0, first=4))
    learnt = learn(learner, blinking(face, 10.0, 0.3), 8.5)
    assert asked.asked
    np.testing.assert_allclose(learnt.shape, asked.shape, atol=1e-12)
    assert learnt.shut == pytest.approx(0.3, abs=0.05)


def test_lids_shut_tightly_in_the_calibration_still_meet_in_a_weak_blink():
    face = person()
    asked = replace(calibrate(blinking(face, 4.0, 0.3), 0.0, 1.0), shut=0.1)
    assert learn(PerformerLearner(asked), blinking(face, 10.0, 0.3)).shut == pytest.approx(0.3, abs=0.05)
    assert learn(PerformerLearner(replace(asked, shut=0.4)), blinking(face, 10.0, 0.3)).shut == pytest.approx(0.4)


@pytest.mark.thorough
@pytest.mark.parametrize("minutes", [4, pytest.param(60, marks=pytest.mark.timeout(1800))])
def test_repeating_a_clip_gives_the_same_result_as_a_minute_of_it(minutes):
    face = person()
    clip = performing(face, 12.0, first=2)
    learner = PerformerLearner(first_second(clip))
    ends = []
    for repeat in range(minutes * 5):
        ends.append(learn(learner, clip, repeat * 12.0))
    opening = float(eye_apertures(face).mean())
    assert abs(float(eye_apertures(ends[-1].shape).mean()) / opening - 1.0) < 0.05
    assert float(np.linalg.norm(ends[-1].shape - ends[4].shape, axis=1).mean()) < 0.005
    assert off(ends[-1], face) < off(ends[0], face) + 0.002


def test_a_new_performer_is_learnt_from_scratch():
    one, other = person(3), person(8)
    learner = PerformerLearner(first_second(performing(one, 2.0)))
    learn(learner, performing(one, 20.0))
    assert learner.is_sure
    changed = learn(learner, performing(other, 30.0), 40.0)
    assert off(changed, at_rest(other)) < 0.25 * off(changed, at_rest(one))


def test_the_learnt_neutral_face_changes_slowly():
    take = performing(person(), 20.0, first=9)
    learner = PerformerLearner(replace(first_second(take), shape=take.shape[0].astype(float)))
    steps, before = [], learner.neutral.shape
    far = np.abs(before - person()).max()
    for frame, time in enumerate(take.times.tolist()):
        now = learner.add(time, take.result(frame)).shape
        steps.append(np.abs(now - before).max())
        before = now
    assert max(steps) < 0.25 * far


def test_the_learnt_neutral_face_survives_saving_and_opening():
    learnt = learn(PerformerLearner(first_second(take := blinking(person(), 12.0, 0.25))), take)
    again = Neutral.from_dict(learnt.to_dict())
    assert not again.asked and again.shut == learnt.shut
    old = {name: value for name, value in learnt.to_dict().items() if name != "asked"}
    assert Neutral.from_dict(old).asked


def test_eyes_keep_their_direction_when_the_neutral_face_is_improved_during_a_blink():
    head, unknown = np.eye(3), np.full(2, np.nan)
    before, after = EyeDriver(np.zeros(2)), EyeDriver(np.array([0.0, 0.02]))
    before.rotations(np.array([0.05, 0.2]), np.nan, head)
    after.follow(before)
    np.testing.assert_allclose(
        after.rotations(unknown, np.nan, head), EyeDriver(np.zeros(2)).rotations(np.array([0.05, 0.18]), np.nan, head)
    )
