"""Eyes of a head turn by the performer's gaze, relative to the usual one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.drive.drive_settings import DriveSettings, PosingSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.posing import _ASIDE, _LASTING, _PARALLEL, EyeDriver, eye_strength, gaze_at_viewer
from facemime.core.face.rotation import euler_to_matrix, matrix_to_euler
from facemime.core.takes.neutral import calibrate
from tests.helpers.built_in import performer
from tests.helpers.takes import make_take


@settings(max_examples=50)
@given(st.floats(-0.1, 0.1), st.floats(-0.35, 0.35))
def test_eyes_stay_on_the_viewer_while_the_head_turns_a_little(pitch, yaw):
    rotation = euler_to_matrix(pitch, yaw, 0.0)
    forward = rotation @ gaze_at_viewer(rotation) @ np.array([0.0, 0.0, -1.0])
    assert forward @ np.array([0.0, 0.0, -1.0]) > np.cos(np.radians(4.0))


def test_eyes_turn_by_the_gaze_relative_to_the_usual_one(rig):
    face = performer(rig)
    gaze = np.tile([0.05, -0.1], (60, 1))
    gaze[50:] += (0.0, 0.2)
    neutral = calibrate(make_take(np.tile(face, (60, 1, 1)), gaze=gaze))
    np.testing.assert_allclose(neutral.gaze, (0.05, -0.1), atol=0.002)
    eyes = EyeDriver(gaze[0])
    for eye in eyes.rotations(gaze[0], np.nan, np.eye(3)):
        np.testing.assert_allclose(eye, np.eye(3), atol=1e-9)
    for eye in eyes.rotations(gaze[55], np.nan, np.eye(3)):
        np.testing.assert_allclose(matrix_to_euler(eye), (0.0, 0.2, 0.0), atol=1e-9)


def usual_gaze(rig, gaze, pose=None, start=None) -> np.ndarray:
    return calibrate(make_take(np.tile(performer(rig), (len(gaze), 1, 1)), gaze=gaze, pose=pose), start).gaze


def test_the_usual_gaze_is_the_most_frequent_one_even_if_the_performer_mostly_looks_elsewhere(rig):
    camera, elsewhere = (0.05, -0.1), np.random.default_rng(1).uniform((0.2, -0.4), (0.6, 0.4), (70, 2))
    gaze = np.vstack([np.tile(camera, (30, 1)), elsewhere])
    gaze[::9] = np.nan
    np.testing.assert_allclose(usual_gaze(rig, gaze), camera, atol=0.02)


def test_who_looks_at_the_camera_with_a_turning_head_has_a_constant_usual_gaze(rig):
    bias, turns = np.array([0.03, 0.06]), np.random.default_rng(2).uniform(-0.4, 0.4, (60, 3)) * (1.0, 1.0, 0.2)
    turns -= np.median(turns, axis=0)
    heads = [euler_to_matrix(*turn) for turn in turns]
    gaze = np.array([matrix_to_euler(head.T)[:2] for head in heads]) + bias
    pose = np.column_stack([np.full(60, 100.0), turns, np.full((60, 2), 200.0)])
    np.testing.assert_allclose(usual_gaze(rig, gaze, pose), bias, atol=1e-6)
    turns[:] = turns[0]
    gaze[:] = gaze[0]
    pose[:] = pose[0]
    np.testing.assert_allclose(usual_gaze(rig, gaze, pose, 0.0), gaze[0], atol=1e-6)


@pytest.mark.parametrize(
    ("pitch", "gaze", "straight"),
    [(0.1, -0.1, 0.1), (-0.1, 0.06, -0.06), (0.1, 0.1, 0.0), (0.1, -0.2, 0.1), (0.4, -0.4, 0.18)],
)
def test_a_head_whose_usual_pitch_the_eyes_are_turned_against_faces_the_camera(rig, pitch, gaze, straight):
    pose = np.tile([100.0, pitch, 0.1, 0.0, 320.0, 240.0], (40, 1))
    take = make_take(np.tile(performer(rig), (40, 1, 1)), gaze=np.tile((gaze, -0.1), (40, 1)), pose=pose)
    np.testing.assert_allclose(matrix_to_euler(calibrate(take).rotation), (straight, 0.0, 0.0), atol=0.003)


def test_the_eyes_of_who_faces_a_screen_beside_the_camera_are_straight(rig):
    pose = np.tile([100.0, 0.4, 0.45, 0.0, 320.0, 240.0], (40, 1))
    take = make_take(np.tile(performer(rig), (40, 1, 1)), gaze=np.tile((0.0, 0.0), (40, 1)), pose=pose)
    neutral = calibrate(take)
    np.testing.assert_allclose(neutral.gaze, 0.0, atol=0.03)
    np.testing.assert_allclose(neutral.rotation, np.eye(3), atol=0.03)


def test_who_always_looks_aside_is_shown_so_but_a_pitch_that_is_always_large_is_limited(rig):
    np.testing.assert_allclose(usual_gaze(rig, np.tile((-0.5, 0.6), (40, 1))), (-0.18, 0.0), atol=1e-6)
    np.testing.assert_allclose(usual_gaze(rig, np.tile((-0.05, 0.6), (40, 1))), (-0.05, 0.0), atol=1e-6)


def test_the_eyes_of_who_rests_turned_away_from_the_camera_are_straight(rig):
    pose = np.tile([100.0, 0.1, 0.4, 0.0, 320.0, 240.0], (40, 1))
    np.testing.assert_allclose(usual_gaze(rig, np.zeros((40, 2)), pose, 0.0), 0.0, atol=0.03)


def test_who_looks_aside_from_a_tilted_head_does_not_roll_the_eyes_up(rig):
    pose = np.tile([100.0, -0.05, 0.79, -0.24, 320.0, 240.0], (40, 1))
    take = make_take(np.tile(performer(rig), (40, 1, 1)), gaze=np.tile((-0.03, -0.19), (40, 1)), pose=pose)
    np.testing.assert_allclose(take.gaze[0] - calibrate(take).gaze, (0.0, -0.19), atol=0.03)


def test_eyes_cross_by_the_excess_of_their_vergence_over_the_usual_one():
    eyes = EyeDriver(np.zeros(2), 0.1)
    for vergence, turned in ((0.1, 0.0), (0.12, 0.0), (0.1 + _PARALLEL + 0.2, 0.1), (0.1 - _PARALLEL - 0.2, -0.1)):
        for _ in range(_LASTING):
            right, left = eyes.rotations(np.zeros(2), vergence, np.eye(3))
        np.testing.assert_allclose(matrix_to_euler(right), (0.0, -turned, 0.0), atol=1e-9)
        np.testing.assert_allclose(matrix_to_euler(left), (0.0, turned, 0.0), atol=1e-9)


def test_a_pupil_that_is_misplaced_in_one_frame_does_not_cross_the_eyes():
    eyes = EyeDriver(np.zeros(2), 0.0)
    for vergence in (0.0, 0.6, 0.0, -0.6, 0.6):
        for eye in eyes.rotations(np.zeros(2), vergence, np.eye(3)):
            np.testing.assert_array_equal(eye, np.eye(3))


def test_eyes_turn_as_far_as_the_performers_and_stay_while_shut():
    eyes = EyeDriver(np.zeros(2))
    far = eyes.rotations(np.array([0.4, -0.5]), np.nan, np.eye(3))
    for eye in far:
        np.testing.assert_allclose(matrix_to_euler(eye), (0.4, -0.5, 0.0), atol=1e-9)
    np.testing.assert_allclose(eyes.rotations(np.full(2, np.nan), np.nan, np.eye(3)), far)


def test_the_eyes_of_a_head_turn_up_to_the_limit_of_the_settings(rig):
    take = make_take(np.tile(performer(rig), (2, 1, 1)), gaze=np.array([(0.0, 0.0), (0.0, 1.0)]))
    for limit in (0.2, 0.6):
        settings = DriveSettings(posing=PosingSettings(eyes_limit=limit))
        driver = HeadDriver(rig, replace(calibrate(take, start=0.0, duration=0.01), gaze=np.zeros(2)), settings)
        for eye in driver.frame(take.result(1)).gaze:
            np.testing.assert_allclose(matrix_to_euler(eye), (0.0, limit, 0.0), atol=1e-6)


def test_without_a_known_gaze_eyes_stay_on_the_viewer(rig):
    face = performer(rig)
    neutral = calibrate(make_take(np.tile(face, (60, 1, 1))))
    assert np.isnan(neutral.gaze).all()
    head = euler_to_matrix(0.05, 0.2, 0.0)
    for eye in EyeDriver(neutral.gaze).rotations(np.full(2, np.nan), np.nan, head):
        np.testing.assert_allclose(eye, gaze_at_viewer(head))


def test_an_eye_that_turns_about_a_far_point_turns_less_so_that_its_iris_stays_between_the_lids():
    corners = np.array([[-0.5, 0.0, 0.0], [-0.18, 0.0, 0.0]])
    middle, half_width = corners.mean(axis=0), 0.16
    assert eye_strength(middle + [0.0, 0.0, 0.13], corners) == 1.0
    far = eye_strength(middle + [0.1, 0.0, 0.5], corners)
    moved = np.hypot(0.1, 0.5) * np.sin(far * _ASIDE)
    assert 0.45 * half_width < moved < 0.52 * half_width
    assert eye_strength(middle, corners) == 1.0
