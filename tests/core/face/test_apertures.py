"""Apertures of eyes and mouth, and the angles of a result."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.face.landmarks import (
    LOWER_LIDS,
    LOWER_LIPS,
    MIRROR,
    UPPER_LIDS,
    UPPER_LIPS,
    eye_apertures,
    mouth_aperture,
)
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker


@pytest.fixture(scope="module")
def face() -> np.ndarray:
    return FaceTracker.load().pdm.mean_shape


def test_the_mean_face_has_open_eyes_and_almost_closed_lips(face):
    assert (eye_apertures(face) > 0.06).all()
    assert 0.0 < mouth_aperture(face) < 0.1


@settings(max_examples=30)
@given(st.floats(-3.0, 3.0), st.floats(0.1, 500.0), st.floats(-1e3, 1e3))
def test_apertures_are_invariant_to_rotation_and_translation_and_scale_with_the_image(face, roll, scale, shift):
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    seen = scale * face[:, :2] @ turn.T + shift
    np.testing.assert_allclose(eye_apertures(seen), scale * eye_apertures(face), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(mouth_aperture(seen), scale * mouth_aperture(face), rtol=1e-6, atol=1e-9)


def test_closed_rims_have_aperture_zero_and_crossed_ones_a_negative_one(face):
    for upper, lower, aperture in ((UPPER_LIDS, LOWER_LIDS, eye_apertures), (UPPER_LIPS, LOWER_LIPS, mouth_aperture)):
        shut = face.copy()
        shut[lower] = shut[upper]
        np.testing.assert_allclose(aperture(shut), 0.0)
        shut[lower, 1] -= 0.05
        assert (aperture(shut) < -0.04).all()


def test_mirroring_a_face_swaps_the_apertures_of_its_eyes(face):
    face = face.copy()
    face[UPPER_LIDS[:2], 1] += 0.04
    mirrored = face[MIRROR] * (-1.0, 1.0, 1.0)
    np.testing.assert_allclose(eye_apertures(mirrored), eye_apertures(face)[::-1], rtol=1e-6)
    np.testing.assert_allclose(mouth_aperture(mirrored), mouth_aperture(face), rtol=1e-6)


def test_apertures_are_vectorised(face):
    many = np.stack([face, 2.0 * face])[:, None]
    assert eye_apertures(many).shape == (2, 1, 2) and mouth_aperture(many).shape == (2, 1)
    np.testing.assert_allclose(eye_apertures(many)[1, 0], 2.0 * eye_apertures(face))


def test_a_result_states_degrees_and_apertures_of_its_own_shape(face):
    pose = np.array([100.0, 0.1, -0.2, 0.3, 320.0, 240.0])
    result = TrackResult(True, face[:, :2], pose, np.zeros(3), face, 0.9)
    np.testing.assert_allclose(result.head_pose_degrees, np.degrees([0.1, -0.2, 0.3]))
    np.testing.assert_allclose(result.eye_apertures, eye_apertures(face))
    assert result.mouth_aperture == mouth_aperture(face)


def test_without_a_face_every_array_is_nan():
    nothing = TrackResult.nothing(7)
    assert not nothing.found and nothing.confidence == 0.0 and nothing.shape_params.shape == (7,)
    for name in ("landmarks", "pose", "shape", "landmark_confidence", "pupils", "gaze", "eye_apertures"):
        assert np.isnan(getattr(nothing, name)).all()
