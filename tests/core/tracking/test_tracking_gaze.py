"""Pupils and gaze on drawn eyes, whose balls are turned by known angles."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike

from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT, LOWER_LIDS, UPPER_LIDS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.tracking.experts import standardise_part
from facemime.core.tracking.gaze import _BALL, _BALL_RADIUS, Gaze, PupilExperts, find_gaze
from facemime.core.tracking.model_file import load_model
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker

CLIP = Path(__file__).parents[3] / "assets" / "sample" / "sample.mp4"
SIZE = (480, 640)


@pytest.fixture(scope="module")
def shape() -> np.ndarray:
    """A face with wide open eyes."""
    open_face = FaceTracker.load().pdm.mean_shape.copy()
    open_face[UPPER_LIDS, 1] -= 0.04
    open_face[LOWER_LIDS, 1] += 0.03
    return open_face


@pytest.fixture(scope="module")
def experts() -> PupilExperts:
    return load_model(DEFAULT_MODEL).pupils


def project(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return pose[0] * points @ euler_to_matrix(*pose[1:4])[:2].T + pose[4:6]


def true_pupils(shape: np.ndarray, pose: np.ndarray, gaze: ArrayLike) -> np.ndarray:
    """Pupils (2, 2) of eyes with a common gaze (2,), or one each (2, 2)."""
    centres = np.array([shape[eye[[0, 3]]].mean(axis=0) for eye in (EYE_RIGHT, EYE_LEFT)]) + _BALL
    ahead = [euler_to_matrix(*each, 0.0) @ (0.0, 0.0, -1.0) for each in np.broadcast_to(gaze, (2, 2))]
    return project(centres + _BALL_RADIUS * np.array(ahead), pose)


def drawn(shape: np.ndarray, pose: np.ndarray, gaze: ArrayLike, iris: int = 60) -> np.ndarray:
    """Grey image of skin, whites, irises and pupils, with a little noise."""
    landmarks, pupils = project(shape, pose), true_pupils(shape, pose, gaze)
    skin = np.full(SIZE, 150, np.uint8)
    for eye, pupil in zip((EYE_RIGHT, EYE_LEFT), pupils, strict=True):
        inside, ball = np.zeros_like(skin), np.full_like(skin, 215)
        cv2.fillPoly(inside, [np.round(landmarks[eye] * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
        for radius, tone in ((0.066, iris), (0.025, 15)):
            at = np.round(pupil * 16).astype(int).tolist()
            cv2.circle(ball, at, round(radius * pose[0] * 16), tone, -1, cv2.LINE_AA, 4)
        skin = np.where(inside > 127, ball, skin)
    noise = np.random.default_rng(0).normal(0, 2, SIZE)
    return np.clip(cv2.GaussianBlur(skin, (0, 0), 0.8) + noise, 0, 255).astype(np.uint8)


def gaze_of(
    experts: PupilExperts, grey: np.ndarray, pose: np.ndarray, landmarks: np.ndarray, shape: np.ndarray
) -> Gaze:
    """Gaze of the eyes in an image, by the network and by gradients."""
    band = experts.band(grey, pose, landmarks)
    (told,) = experts.network(standardise_part(band.pixels)[None])
    return find_gaze(experts.refine(band, told), pose, landmarks, shape)


def pose_of(scale: float, pitch: float = 0.0, yaw: float = 0.0, roll: float = 0.0) -> np.ndarray:
    return np.array([scale, pitch, yaw, roll, 320.0, 240.0])


POSES = [pose_of(150), pose_of(60), pose_of(300), pose_of(150, 0.2, 0.4, 0.0), pose_of(120, -0.1, -0.3, 0.6)]
GAZES = [(0.0, 0.0), (0.0, 0.35), (0.0, -0.35), (0.12, 0.1), (-0.12, -0.2)]


@pytest.mark.parametrize("pose", POSES, ids=lambda p: "-".join(f"{v:.1f}" for v in p[:4]))
@pytest.mark.parametrize("gaze", GAZES)
def test_pupils_are_located_and_give_the_gaze(experts, shape, pose, gaze):
    found = gaze_of(experts, drawn(shape, pose, gaze), pose, project(shape, pose), shape)
    away = np.linalg.norm(found.pupils - true_pupils(shape, pose, gaze), axis=1)
    assert away.max() < 0.025 * pose[0]
    np.testing.assert_allclose(found.direction, gaze, atol=0.12)


def test_eyes_that_turn_down_and_to_the_viewers_left_have_positive_angles(experts, shape):
    pose = pose_of(150)
    grey = drawn(shape, pose, (0.0, 0.0))
    landmarks = project(shape, pose)
    straight = gaze_of(experts, grey, pose, landmarks, shape).direction
    aside = gaze_of(experts, drawn(shape, pose, (0.15, 0.3)), pose, landmarks, shape)
    assert (aside.direction > straight).all()
    assert (aside.pupils[:, 0] < true_pupils(shape, pose, (0.0, 0.0))[:, 0]).all()


@pytest.mark.parametrize("pose", POSES[:3], ids=lambda p: f"{p[0]:.0f}")
def test_crossed_eyes_have_a_positive_vergence_and_parallel_ones_none(experts, shape, pose):
    for right, left in ((-0.2, 0.3), (0.1, 0.1), (0.15, -0.05)):
        grey = drawn(shape, pose, ((0.0, right), (0.0, left)))
        found = gaze_of(experts, grey, pose, project(shape, pose), shape)
        assert found.vergence == pytest.approx(left - right, abs=0.12)
        assert found.direction[1] == pytest.approx((left + right) / 2, abs=0.1)


def test_the_vergence_of_one_eye_is_unknown(experts, shape):
    pose, winking = pose_of(150), shape.copy()
    winking[LOWER_LIDS[:2]] = winking[UPPER_LIDS[:2]]
    found = gaze_of(experts, drawn(winking, pose, (0.0, 0.2)), pose, project(winking, pose), winking)
    assert np.isnan(found.vergence)


def test_bright_irises_are_found_as_dark_ones_are(experts, shape):
    pose = pose_of(150)
    grey = drawn(shape, pose, (0.0, 0.25), iris=150)
    found = gaze_of(experts, grey, pose, project(shape, pose), shape)
    np.testing.assert_allclose(found.direction, (0.0, 0.25), atol=0.12)


@pytest.mark.parametrize("gaze", [(0.0, 0.0), (0.0, 0.3), (0.05, -0.25)])
def test_lashes_and_reflections_are_not_taken_for_the_pupils_of_light_eyes(experts, shape, gaze):
    pose = pose_of(150)
    grey, landmarks = drawn(shape, pose, gaze, iris=170), project(shape, pose)
    for eye, pupil in zip((EYE_RIGHT, EYE_LEFT), true_pupils(shape, pose, gaze), strict=True):
        cv2.polylines(grey, [np.round(landmarks[eye[:4]] * 16).astype(np.int32)], False, (25,), 7, cv2.LINE_AA, 4)
        for aside in ((-0.02, -0.02), (0.015, 0.01)):
            cv2.circle(grey, np.round((pupil + 150.0 * np.array(aside)) * 16).astype(int), 3 * 16, 250, -1, shift=4)
    found = gaze_of(experts, cv2.GaussianBlur(grey, (0, 0), 0.8), pose, landmarks, shape)
    away = np.linalg.norm(found.pupils - true_pupils(shape, pose, gaze), axis=1)
    assert away.max() < 0.08 * pose[0]  # the rim of the iris alone would be 0.09 to 0.12 off


def test_a_shut_eye_has_no_pupil_and_the_other_gives_the_gaze(experts, shape):
    pose = pose_of(150)
    winking = shape.copy()
    winking[LOWER_LIDS[:2]] = winking[UPPER_LIDS[:2]]
    found = gaze_of(experts, drawn(winking, pose, (0.0, 0.2)), pose, project(winking, pose), winking)
    assert np.isnan(found.pupils[0]).all() and np.isfinite(found.pupils[1]).all()
    np.testing.assert_allclose(found.direction, (0.0, 0.2), atol=0.12)


@pytest.mark.parametrize("yaw", [1.15, -1.15])
def test_an_eye_behind_the_nose_has_no_pupil_and_the_other_gives_the_gaze(experts, shape, yaw):
    pose, gaze = pose_of(200, 0.0, yaw), (0.0, -0.5 * np.sign(yaw))
    found = gaze_of(experts, drawn(shape, pose, gaze), pose, project(shape, pose), shape)
    hidden = int(yaw < 0.0)  # a head that turns to the viewer's left hides its right eye
    assert np.isnan(found.pupils[hidden]).all() and np.isfinite(found.pupils[1 - hidden]).all()
    np.testing.assert_allclose(found.direction, gaze, atol=0.2)


def test_with_both_eyes_shut_there_is_no_gaze(experts, shape):
    pose = pose_of(150)
    asleep = shape.copy()
    asleep[LOWER_LIDS] = asleep[UPPER_LIDS]
    found = gaze_of(experts, drawn(asleep, pose, (0.0, 0.0)), pose, project(asleep, pose), asleep)
    assert np.isnan(found.pupils).all() and np.isnan(found.direction).all()


@pytest.mark.parametrize("place", [(-400.0, 240.0), (320.0, 900.0), (0.0, 0.0)])
def test_eyes_outside_the_image_raise_nothing(experts, shape, place):
    pose = np.array([150.0, 0.1, 0.2, 0.3, *place])
    found = gaze_of(experts, np.full(SIZE, 128, np.uint8), pose, project(shape, pose), shape)
    assert found.pupils.shape == (2, 2) and found.direction.shape == (2,)


@pytest.mark.thorough
@pytest.mark.skipif(not CLIP.exists(), reason="assets/sample has no clip; make it with `make sample`")
def test_the_sample_clips_eyes_stay_straight_in_a_turning_head():
    tracker, reader = FaceTracker.load(), cv2.VideoCapture(str(CLIP))
    gaze = []
    while (read := reader.read())[0]:
        gaze.append(tracker.track(read[1]).gaze)
    gaze = np.degrees(gaze)
    assert (np.nanpercentile(np.abs(gaze - np.nanmedian(gaze, axis=0)), 90, axis=0) < 5.0).all()
    assert 0.02 < np.isnan(gaze[:, 0]).mean() < 0.15
