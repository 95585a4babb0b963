"""Takes are solved around their pins, and what pins tell about alike frames is used only if they agree."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import SourceError
from facemime.core.face.landmarks import (
    BROWS,
    CHIN,
    EYE_LEFT,
    EYE_RIGHT,
    JAW,
    LIPS,
    LOWER_LIPS,
    N_LANDMARKS,
    UPPER_LIPS,
    lid_gaps,
    lip_gaps,
)
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.correction import learn, solve_pins, without_pins
from facemime.core.takes.learnt import (
    PARTS,
    Faces,
    Likeness,
    corrected,
    corrected_result,
    learnt_from_json,
    learnt_to_json,
)
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.pins import LEARN, MAX_PINS, Pin, pins_of, with_pins
from facemime.core.takes.take import FIELDS, Take
from facemime.core.takes.timing import mark_lost, project
from tests.helpers.takes import make_take, performance

ALL = np.arange(N_LANDMARKS)


def pin(take: Take, true: np.ndarray, frames, landmarks) -> Take:
    """Pin landmarks (n,) of frames where they truly are, in shapes (N, 66, 3)."""
    places = project(true, take.pose)
    rows = [
        Pin(float(take.times[f]), int(n), *map(float, places[f, n])) for f in np.atleast_1d(frames) for n in landmarks
    ]
    return with_pins(take, [*pins_of(take), *rows])


def seen(take: Take) -> np.ndarray:
    """Shapes of a take (N, 66, 3), in double precision."""
    return take.shape.astype(np.float64)


def learning(take: Take) -> Take:
    return replace(take, info={**take.info, LEARN: True})


def flat(count: int = 150, sure: float = 0.8) -> Take:
    """A take in which the brows rise and fall and the head hardly turns, and all landmarks are equally certain."""
    shape = seen(performance(3))[:1].repeat(count, axis=0)
    shape[:, BROWS, 1] -= 0.05 * (1.0 - np.cos(np.arange(count) / 7.0))[:, None]
    take = make_take(shape)
    return replace(take, landmark_confidence=np.full((count, N_LANDMARKS), sure, np.float32))


def test_a_pinned_chin_says_whether_the_jaw_is_open_not_the_teeth():
    take = replace(flat(), teeth=np.ones(150, np.float32))
    true = seen(take)
    true[:, CHIN, 1] += 0.04
    solved = solve_pins(pin(take, true, 75, CHIN))
    assert np.isnan(solved.teeth[75]) and solved.teeth[0] == 1.0
    true = seen(take)
    true[:, BROWS, 1] -= 0.04
    np.testing.assert_array_equal(solve_pins(pin(take, true, 75, BROWS)).teeth, take.teeth)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3),
    st.lists(st.floats(-0.04, 0.04), min_size=2, max_size=2),
    st.integers(0, len(PARTS) - 1),
)
def test_pinned_landmarks_are_where_they_were_put_in_any_pose(angles, move, part):
    shapes = seen(performance(12))[:5].repeat(2, axis=0)
    poses = np.tile([100.0, *angles, 320.0, 240.0], (10, 1))
    take = make_take(shapes, pose=poses)
    take = replace(take, landmarks=project(shapes, poses).astype(np.float32))
    true = shapes.copy()
    true[:, PARTS[part], :2] += move
    solved = solve_pins(pin(take, true, 4, PARTS[part]))
    off = solved.landmarks[4, PARTS[part]] - project(true, poses)[4, PARTS[part]]
    moved = 100.0 * np.hypot(*move)
    assert np.linalg.norm(off, axis=1).mean() <= 0.05 * moved + 1.5  # shut lids and lips are closed


def test_neighbours_in_time_follow_and_far_frames_stay():
    take = flat()
    take.shape[:] = take.shape[:1]
    true = seen(take)
    true[:, LIPS, 1] += 0.03
    solved = solve_pins(pin(take, true, 75, LIPS))
    follows = (solved.shape - take.shape)[:, LIPS, 1].mean(axis=1)
    assert follows[75] == pytest.approx(0.03, abs=0.001)
    assert 0.025 < follows[76] < follows[75] and (np.diff(follows[75:90]) <= 0.0).all()
    far = np.abs(take.times - take.times[75]) > 1.0
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(solved, name)[far], getattr(take, name)[far])


@pytest.mark.parametrize("part", range(len(PARTS)))
def test_other_parts_of_the_face_do_not_move(part):
    take = flat()
    true = seen(take)
    true[:, PARTS[part], :2] += 0.03
    solved = solve_pins(learning(pin(take, true, [20, 60, 100], PARTS[part])))
    others = np.setdiff1d(ALL, PARTS[part])
    np.testing.assert_array_equal(solved.shape[:, others], take.shape[:, others])
    np.testing.assert_array_equal(solved.landmarks[:, others], take.landmarks[:, others])
    assert (solved.shape[:, PARTS[part]] != take.shape[:, PARTS[part]]).any()


def shut(eye: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Shapes with the lids of an eye on each other."""
    true = true.copy()
    true[:, eye[[1, 2]]] = true[:, eye[[5, 4]]]
    return true


def avatar(take: Take, frame: int) -> np.ndarray:
    """Landmarks of the built-in head that a frame of a take drives."""
    driver = HeadDriver(built_in_head(), calibrate(take, 0.0, 0.5))
    return driver.frame(take.result(frame)).vertices[driver.rig.landmarks].astype(np.float64)


def test_lids_that_are_pinned_shut_are_shut_and_the_avatars_meet():
    take = flat()
    true = shut(EYE_LEFT, shut(EYE_RIGHT, seen(take)))
    solved = solve_pins(pin(take, true, 75, [*EYE_RIGHT, *EYE_LEFT]))
    np.testing.assert_allclose(lid_gaps(seen(solved))[75], 0.0, atol=1e-3)
    rest = lid_gaps(avatar(take, 0))
    assert (lid_gaps(avatar(take, 75)) / rest > 0.9).all()
    assert (lid_gaps(avatar(solved, 75)) / rest < 0.03).all()


def test_lips_that_are_pinned_shut_are_shut_and_the_avatars_meet():
    take = flat()
    take.shape[:] = take.shape[:1]
    open_ = take.shape.copy()
    open_[60:90, [*LOWER_LIPS], 1] += 0.08
    take = replace(take, shape=open_, landmarks=project(open_.astype(float), take.pose).astype(np.float32))
    true = seen(take)
    true[:, LOWER_LIPS, :2] = true[:, UPPER_LIPS, :2]
    solved = solve_pins(pin(take, true, 75, LIPS))
    np.testing.assert_allclose(lip_gaps(seen(solved))[75], 0.0, atol=1e-3)
    width = np.ptp(avatar(take, 0)[LIPS, 0])
    assert lip_gaps(avatar(take, 75)).mean() > 0.05 * width
    assert np.abs(lip_gaps(avatar(solved, 75))).max() < 0.01 * width


def test_a_single_frame_is_solved():
    take = make_take(seen(performance(3))[:1])
    true = seen(take)
    true[:, JAW, 1] += 0.05
    solved = solve_pins(learning(pin(take, true, 0, JAW)))
    np.testing.assert_allclose(solved.shape[0, JAW, 1], true[0, JAW, 1], atol=0.005)
    assert learn(pin(take, true, 0, JAW)) == ()


def test_pins_of_a_gap_count_once_it_is_filled():
    take = flat()
    true = seen(take)
    true[:, JAW, 1] += 0.05
    gap = mark_lost(take, (np.arange(150) > 70) & (np.arange(150) < 80))
    pinned = (
        pin(gap, true, 75, JAW)
        if np.isfinite(gap.pose[75]).all()
        else with_pins(gap, pins_of(pin(take, true, 75, JAW)))
    )
    assert solve_pins(pinned).shape[74].tobytes() == gap.shape[74].tobytes()
    filled = solve_pins(replace(take, info=pinned.info))
    np.testing.assert_allclose(filled.shape[75, JAW, 1], true[75, JAW, 1], atol=0.005)


def test_two_pins_on_one_landmark_of_a_frame_agree_on_the_middle():
    take = flat()
    x, y = take.landmarks[75, 8].astype(float)
    pins = [Pin(float(take.times[75]) + away, 8, x, y + 4.0 * number) for number, away in enumerate((-0.001, 0.001))]
    assert solve_pins(with_pins(take, pins)).landmarks[75, 8, 1] == pytest.approx(y + 2.0, abs=0.2)


def test_dropping_the_pins_of_a_solved_take_leaves_it_as_it_is():
    take = flat()
    true = seen(take)
    true[:, JAW, 1] += 0.05
    pinned = learning(pin(take, true, [20, 100], JAW))
    plain = without_pins(pinned)
    assert pins_of(plain) == () and LEARN not in plain.info
    np.testing.assert_array_equal(plain.shape, solve_pins(pinned).shape)


def errors(take: Take, true: np.ndarray, part: np.ndarray) -> np.ndarray:
    return np.linalg.norm(take.shape - true, axis=2)[:, part].mean(axis=1)


def test_a_systematic_error_is_reduced_in_frames_without_pins():
    take = flat()
    true = seen(take)
    true[:, BROWS[:5], 1] -= 0.04
    pinned = pin(take, true, [20, 55, 100], BROWS[:5])
    usual, learnt = errors(solve_pins(pinned), true, BROWS[:5]), errors(solve_pins(learning(pinned)), true, BROWS[:5])
    assert np.median(usual) > 0.035 and np.median(learnt) < 0.02
    assert learnt.max() < 0.041


def test_errors_without_a_system_tell_nothing_about_other_frames():
    take = flat()
    rng = np.random.default_rng(2)
    true = seen(take)
    true[:, BROWS[:5], :2] += rng.normal(0.0, 0.03, (150, 1, 2))
    pinned = pin(take, true, [20, 40, 64, 85, 110, 130], BROWS[:5])
    assert learn(pinned) == ()
    np.testing.assert_array_equal(solve_pins(learning(pinned)).shape, solve_pins(pinned).shape)


def test_frames_unlike_any_that_was_pinned_are_not_changed():
    take = flat()
    true = seen(take)
    true[:, BROWS[:5], 1] -= 0.04
    learnt = learn(pin(take, true, [20, 55, 100], BROWS[:5]))
    assert {one.part for one in learnt} == {1}
    other = flat(20)
    alike = np.abs(corrected(other, learnt).shape - other.shape).max()
    other.shape[:, BROWS, 1] += 0.5
    assert alike > 0.02
    assert np.abs(corrected(other, learnt).shape - other.shape).max() < 1e-4
    turned = replace(flat(20), pose=flat(20).pose + [0.0, 0.0, 2.5, 0.0, 0.0, 0.0])
    assert np.abs(corrected(turned, learnt).shape - turned.shape).max() < 1e-4


def test_a_missed_blink_tells_nothing_about_open_eyes():
    take = flat()
    blinks = np.arange(150) % 30 < 3
    take.landmark_confidence[blinks[:, None] & np.isin(ALL, EYE_RIGHT)] = 0.7
    true = np.where(blinks[:, None, None], shut(EYE_RIGHT, seen(take)), seen(take))
    solved = solve_pins(learning(pin(take, true, [31, 61, 91], EYE_RIGHT)))
    gaps = lid_gaps(seen(solved))[:, :2].mean(axis=1) / lid_gaps(seen(take))[:, :2].mean(axis=1)
    assert gaps[blinks].max() < 0.2
    assert gaps[~blinks & ~np.roll(blinks, 3) & ~np.roll(blinks, -3)].min() > 0.99


def test_takes_of_unknown_certainty_are_corrected_alike():
    take = flat(sure=np.nan)
    true = seen(take)
    true[:, BROWS[:5], 1] -= 0.04
    learnt = learn(pin(take, true, [20, 55, 100], BROWS[:5]))
    for other in (flat(20, np.nan), flat(20, 0.5)):
        assert np.abs(corrected(other, learnt).shape - other.shape).max() > 0.02


def test_a_live_result_is_corrected_as_a_take_is():
    take = performance()
    true = seen(take)
    true[:, BROWS, 1] -= 0.04
    true[:, LIPS, 0] += 0.03
    learnt = learn(pin(take, true, [5, 12, 20], [*BROWS, *LIPS]))
    assert {one.part for one in learnt} == {1, 2, 6}
    whole = corrected(take, learnt)
    for frame in (0, 25, 45):
        result = corrected_result(take.result(frame), learnt)
        np.testing.assert_allclose(result.shape, whole.shape[frame], atol=1e-6)
        np.testing.assert_allclose(result.landmarks, whole.landmarks[frame], atol=1e-3)
    lost = take.result(30)
    assert corrected_result(lost, learnt) is lost
    assert corrected(take, ()) is take


def test_certainty_that_always_varies_does_not_keep_alike_frames_apart():
    take = flat()
    true = seen(take)
    true[:, LIPS, 1] += 0.03
    take.landmark_confidence[:, LIPS] += np.where(np.arange(150) % 2, 0.04, -0.04)[:, None]
    solved = solve_pins(learning(pin(take, true, [20, 56, 100], LIPS)))
    odd = errors(solved, true, LIPS)[1::2]
    assert odd.max() < 0.01


def test_likeness_is_that_of_the_definition():
    take = performance(12)
    take.landmark_confidence[:] = np.random.default_rng(0).uniform(0.7, 0.9, (len(take), N_LANDMARKS))
    rows = np.flatnonzero(take.found)
    faces = Faces.of(seen(take)[rows], take.pose[rows], take.landmark_confidence[rows])
    part, frames, reach = PARTS[1], np.array([0, 5]), 0.03
    like = Likeness([faces.looks(1, frames, reach, 0.02)]).of(faces)
    flat_ = take.shape[rows][:, part, :2].astype(float)
    apart = np.square(flat_[:, None] - flat_[frames]).sum(axis=3).mean(axis=2) / reach**2
    turned = np.square(take.pose[rows, None, 1:3] - take.pose[rows][frames, 1:3]).sum(axis=2) / 0.4**2
    sure = take.landmark_confidence[rows][:, part].astype(float).mean(axis=1)
    unlike = np.square((sure[:, None] - sure[frames]) / 0.02)
    np.testing.assert_allclose(like, np.exp(-0.5 * (apart + turned + unlike)), atol=1e-6)


def some_learnt():
    take = flat(sure=np.nan)
    true = seen(take)
    true[:, BROWS, 1] -= 0.04
    return learn(pin(take, true, [20, 55, 100], BROWS))


def test_what_was_learnt_survives_json():
    learnt = some_learnt()
    again = learnt_from_json(learnt_to_json(learnt))
    json.loads(learnt_to_json(learnt), parse_constant=pytest.fail)
    take = flat(30)
    np.testing.assert_allclose(corrected(take, again).shape, corrected(take, learnt).shape, atol=1e-4)


def test_what_earlier_versions_learnt_is_read():
    data = json.loads(learnt_to_json(some_learnt()))
    for one in data:
        del one["unsure"]
    assert {one.looks.unsure for one in learnt_from_json(json.dumps(data))} == {0.015}


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[0].update(unsure=0.0),
        lambda data: data[0].update(unsure=None),
        lambda data: data[0].update(part=9),
        lambda data: data[0].update(part="1"),
        lambda data: data[0].update(part=-1),
        lambda data: data[0].pop("values"),
        lambda data: data[0].update(reach=0.0),
        lambda data: data[0].update(reach=None),
        lambda data: data[0].update(moved=[]),
        lambda data: data[0]["values"][0].pop(),
        lambda data: data[0]["moved"][0][0].__setitem__(0, 1e9),
        lambda data: data[0]["moved"][0][0].__setitem__(0, None),
        lambda data: data[0]["certainty"].__setitem__(0, 1e9),
        lambda data: data.append(None),
    ],
)
def test_damage_to_what_was_learnt_is_one_error(change):
    data = json.loads(learnt_to_json(some_learnt()))
    change(data)
    with pytest.raises(SourceError, match="Learn it again"):
        learnt_from_json(json.dumps(data))


@pytest.mark.parametrize("text", ["", "null", "3", "{}x", "[[]]", "[" * 100_000, "[1e999]", "[NaN]"])
def test_other_text_is_one_error(text):
    with pytest.raises(SourceError, match="Learn it again"):
        learnt_from_json(text)


@pytest.mark.thorough
def test_as_many_pins_as_are_allowed_on_one_part_are_solved():
    take = flat(200)
    true = seen(take)
    true[:, LIPS, 1] += 0.03
    frames = np.arange(0, 2 * (MAX_PINS // len(LIPS)), 2) % 200
    solved = solve_pins(learning(pin(take, true, np.unique(frames), LIPS)))
    assert errors(solved, true, LIPS).max() < 0.01  # lips that are all but shut are closed


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(-1.0, 4.0),
            st.integers(0, N_LANDMARKS - 1),
            st.floats(-2000.0, 2000.0),
            st.floats(-2000.0, 2000.0),
        ),
        min_size=1,
        max_size=60,
    ),
    st.booleans(),
)
def test_any_pins_give_a_take_of_numbers(rows, learns):
    take = with_pins(performance(), [Pin(*row) for row in rows])
    solved = solve_pins(learning(take) if learns else take)
    assert np.isfinite(solved.shape[take.found]).all() and np.isfinite(solved.landmarks[take.found]).all()
    assert np.isnan(solved.shape[~take.found]).all()
    assert np.abs(solved.shape[take.found]).max() < 30.0
    np.testing.assert_array_equal(solved.times, take.times)


def test_a_lid_that_is_not_pinned_closes_the_eye_onto_one_that_is():
    take = flat()
    true = seen(take)
    upper = EYE_RIGHT[[1, 2]]
    true[:, upper] = true[:, EYE_RIGHT[[5, 4]]]
    solved = solve_pins(pin(take, true, 75, upper))
    np.testing.assert_allclose(lid_gaps(seen(solved))[75, :2], 0.0, atol=1e-3)
    assert np.abs(solved.landmarks[75, upper] - project(true, take.pose)[75, upper]).max() < 0.6
