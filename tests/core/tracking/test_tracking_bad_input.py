"""The tracker gives a result or no face for any input, never an exception, and always terminates."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.errors import FacemimeError
from facemime.core.face.landmarks import EDGES, INNER, N_LANDMARKS
from facemime.core.numeric.arrays import as_image
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.thorough import first_of

CLIP = Path(__file__).parents[3] / "assets" / "sample" / "sample.mp4"
pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(not CLIP.exists(), reason="assets/sample has no clip; make it with `make sample`"),
]


@pytest.fixture(scope="module")
def face() -> np.ndarray:
    """A frame (480, 640, 3) with one face towards the camera."""
    _, frame = cv2.VideoCapture(str(CLIP)).read()
    return frame


@pytest.fixture(scope="module")
def landmarks(tracker: FaceTracker, face: np.ndarray) -> np.ndarray:
    return tracker.locate(face).landmarks


def assert_whole(result: TrackResult) -> None:
    """Check that a result is complete if found, and empty otherwise; shut eyes may lack a pupil."""
    assert result.landmarks.shape == (N_LANDMARKS, 2) and result.landmark_confidence.shape == (N_LANDMARKS,)
    always = (result.landmarks, result.shape, result.pose, result.shape_params, result.landmark_confidence)
    if not result.found:
        assert all(np.isnan(a).all() for a in (*always, result.pupils, result.gaze))
        return
    assert all(np.isfinite(a).all() for a in always)
    assert 0.0 <= result.confidence <= 1.0
    assert (result.landmark_confidence >= 0.0).all() and (result.landmark_confidence <= 1.0).all()
    assert np.isfinite(result.gaze).all() == np.isfinite(result.pupils).all(axis=1).any()


def look(tracker: FaceTracker, image: np.ndarray) -> TrackResult:
    """Process an image on its own, as the first frame of a clip, and as the next one."""
    tracker.reset()
    alone = tracker.locate(image)
    for result in (alone, tracker.track(image), tracker.track(image)):
        assert_whole(result)
    return alone


KINDS = {
    "grey": lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY),
    "grey with an axis": lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[..., None],
    "with alpha": lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2BGRA),
    "16 bit": lambda image: image.astype(np.uint16) * 257,
    "float": lambda image: image.astype(np.float32) / 255.0,
    "double": lambda image: image.astype(np.float64) / 255.0,
    "half": lambda image: (image / 255.0).astype(np.float16),
    "not contiguous": lambda image: np.asfortranarray(image)[:, ::-1][:, ::-1],
    "read only": lambda image: np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_face_in_another_kind_of_array_is_the_same_face(tracker, face, landmarks, kind):
    result = look(tracker, KINDS[kind](face))
    assert result.found
    np.testing.assert_allclose(result.landmarks, landmarks, atol=1.5)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_face_is_found_in_a_float_image_with_nan_holes(tracker, face, landmarks, value):
    holed = face.astype(np.float32) / 255.0
    holed[:40], holed[::37, ::41] = value, value
    result = look(tracker, holed)
    assert result.found
    assert np.linalg.norm(result.landmarks - landmarks, axis=1).mean() < 6.0


def test_values_that_are_not_finite_become_black():
    image = np.array([[np.nan, np.inf, -np.inf, 0.5, 7.0, -7.0]], np.float32)
    np.testing.assert_array_equal(as_image(image), [[0, 0, 0, 128, 255, 0]])


@settings(max_examples=25)
@given(height=st.integers(1, 64), width=st.integers(1, 64), seed=st.integers(0, 99))
def test_a_face_shrunk_to_almost_nothing_gives_a_result_or_none(tracker, face, height, width, seed):
    small = cv2.resize(face, (width, height), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).integers(-20, 20, small.shape)
    look(tracker, np.clip(small + noise, 0, 255).astype(np.uint8))


def test_a_tiny_image_has_no_face(tracker, face):
    assert not look(tracker, cv2.resize(face, (16, 16))).found


def test_the_face_in_an_8k_image_is_located(tracker, face, landmarks):
    huge = cv2.resize(face, (5760, 4320), interpolation=cv2.INTER_LINEAR)
    huge = cv2.copyMakeBorder(huge, 0, 0, 960, 960, cv2.BORDER_REPLICATE)
    tracker.reset()
    result = tracker.locate(huge)
    assert_whole(result)
    assert result.found
    away = np.linalg.norm(result.landmarks - (landmarks * 9.0 + (964.0, 4.0)), axis=1)
    assert away.mean() < 0.05 * result.pose[0]


@pytest.mark.parametrize(
    ("width", "height"),
    first_of([(1280, 720), (1920, 1080), (3840, 2160)], rows=True),
)
def test_a_small_face_in_a_large_image_is_located(tracker, face, landmarks, width, height):
    factor = 18.0 * width / 1280 / tracker.locate(face).pose[0]
    small = cv2.resize(face, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    picture = np.random.default_rng(0).normal(110.0, 6.0, (height, width, 3)).clip(0, 255).astype(np.uint8)
    x, y = width // 3, height // 5
    picture[y : y + len(small), x : x + small.shape[1]] = small
    tracker.reset()
    result = tracker.locate(picture)
    assert result.found
    away = np.linalg.norm(result.landmarks - ((landmarks + 0.5) * factor - 0.5 + (x, y)), axis=1)
    assert away.mean() < 0.05 * result.pose[0]


@pytest.mark.parametrize(("top", "side"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)])
def test_close_ups_and_faces_cut_by_the_border_are_found(tracker, face, landmarks, top, side):
    low, high = landmarks.min(axis=0), landmarks.max(axis=0)
    first = (low + (high - low) * (side, top)).astype(int)
    last = (high + 1).astype(int)
    tracker.reset()
    result = tracker.locate(np.ascontiguousarray(face[first[1] : last[1], first[0] : last[0]]))
    assert result.found
    assert np.linalg.norm(result.landmarks + first - landmarks, axis=1)[INNER].mean() < 0.03 * result.pose[0]


@pytest.mark.parametrize("degrees", first_of([-90, 70, -70, -50, 50, 90], 2))
def test_a_face_on_its_side_is_found(tracker, face, landmarks, degrees):
    turn = cv2.getRotationMatrix2D(landmarks.mean(axis=0).tolist(), -degrees, 1.0)
    lying = cv2.warpAffine(face, turn, face.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    tracker.reset()
    result = tracker.locate(lying)
    assert result.found
    assert np.degrees(result.pose[3]) == pytest.approx(degrees + np.degrees(tracker.locate(face).pose[3]), abs=2.0)
    away = np.linalg.norm(result.landmarks - (landmarks @ turn[:, :2].T + turn[:, 2]), axis=1)
    assert away[INNER].mean() < 0.03 * result.pose[0]


@pytest.mark.parametrize("level", [0, 1, 127, 254, 255])
def test_a_uniform_image_has_no_face(tracker, level):
    assert not look(tracker, np.full((480, 640, 3), level, np.uint8)).found


@pytest.mark.thorough
def test_a_face_upside_down_gives_a_result_or_none(tracker, face):
    look(tracker, np.ascontiguousarray(face[::-1, ::-1]))


@pytest.mark.thorough
@settings(max_examples=20)
@given(dx=st.integers(-640, 640), dy=st.integers(-480, 480))
def test_a_face_that_leaves_the_image_gives_a_result_or_none(tracker, face, dx, dy):
    tracker.reset()
    tracker.track(face)
    move = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
    cut = cv2.warpAffine(face, move, (640, 480), borderValue=(90, 90, 90))
    for result in (tracker.track(cut), tracker.track(cut), tracker.locate(cut)):
        assert_whole(result)


def test_frames_of_changing_size_and_type_are_accepted(tracker, face):
    tracker.reset()
    for image in (face, face[::2, ::2], face[:200], cv2.cvtColor(face, cv2.COLOR_BGR2GRAY), face[:5, :5], face / 255.0):
        assert_whole(tracker.track(image))


def test_a_drawing_gives_a_result_or_none(tracker, landmarks):
    drawing = np.full((480, 640, 3), 255, np.uint8)
    for a, b in EDGES:
        ends = np.round(landmarks[[a, b]]).astype(int).tolist()
        cv2.line(drawing, ends[0], ends[1], (0, 0, 0), 2, cv2.LINE_AA)
    look(tracker, drawing)


def test_in_a_crowd_one_of_the_largest_faces_is_tracked(tracker, face):
    rng = np.random.default_rng(0)
    crowd = np.full((720, 1280, 3), 128, np.uint8)
    person = face[40:440, 120:520]
    sides = [120, 140, 160, 320, 150, 130, 170, 110, 140, 300]
    x, y, row = 0, 0, 0
    for side in sides:
        if x + side > crowd.shape[1]:
            x, y, row = 0, y + row, 0
        shown = cv2.resize(person[:, ::-1] if rng.random() < 0.5 else person, (side, side))
        crowd[y : y + side, x : x + side] = shown
        x, row = x + side, max(row, side)
    result = look(tracker, crowd)
    alone = tracker.locate(face)
    assert result.found
    assert result.pose[0] > 0.6 * alone.pose[0] * 320 / 400


@pytest.mark.thorough
@settings(max_examples=10)
@given(seed=st.integers(0, 1000), blur=st.floats(0.3, 20.0), contrast=st.floats(1.0, 3000.0))
def test_clouds_give_a_result_or_none(tracker, seed, blur, contrast):
    noise = np.random.default_rng(seed).normal(0, contrast, (240, 320)).astype(np.float32)
    look(tracker, np.clip(cv2.GaussianBlur(noise, (0, 0), blur) + 128, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("shape", [(40, 60), (40, 60, 3), (3, 3)])
def test_a_floating_point_image_from_0_to_255_is_refused_and_bright_lights_are_not(shape):
    image = np.random.default_rng(0).uniform(0.0, 255.0, shape).astype(np.float32)
    with pytest.raises(FacemimeError, match=r"must be float in 0\.\.1; its median is .*Divide it by 255"):
        as_image(image)
    image /= 255.0
    image[-1, -1] = 40.0
    assert as_image(image).shape == shape
