"""The interface of the tracker, on good and bad frames."""

from __future__ import annotations

import copy
import pickle
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from facemime.core.errors import FacemimeError
from facemime.core.face.landmarks import INNER, N_LANDMARKS, UPPER_LIDS
from facemime.core.files.capture import read_image
from facemime.core.tracking.result import TrackResult, project_shape
from facemime.core.tracking.tracker import FaceTracker

DATA = Path(__file__).parents[4] / "shared" / "data"
PORTRAIT = Path(__file__).parents[2] / "data" / "portraits" / "collins.jpg"
needs_photos = pytest.mark.skipif(not DATA.exists(), reason="the photographs of ../shared/data are not here")


@pytest.fixture(scope="module")
def photo() -> tuple[np.ndarray, np.ndarray]:
    """A held-out person's photo (BGR) and hand-placed landmarks, 320 pixels wide."""
    from lab.training.tracker.sources import read_photos, split

    chosen = split(read_photos(DATA, "london_neutral"))[1][0]
    image = cv2.imread(str(chosen.path))
    factor = 320 / image.shape[1]
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return small, (chosen.landmarks + 0.5) * factor - 0.5


def assert_keeps_its_promises(tracker: FaceTracker, result: TrackResult) -> None:
    assert result.landmarks.shape == (N_LANDMARKS, 2)
    assert result.shape.shape == (N_LANDMARKS, 3)
    assert result.pose.shape == (6,)
    assert result.shape_params.shape == (tracker.pdm.n_modes,)
    assert 0.0 <= result.confidence <= 1.0
    arrays = (result.landmarks, result.shape, result.pose, result.shape_params)
    if not result.found:
        assert all(np.isnan(a).all() for a in arrays)
        return
    assert all(np.isfinite(a).all() for a in arrays)
    np.testing.assert_allclose(project_shape(result.shape, result.pose), result.landmarks)
    modelled = np.setdiff1d(np.arange(N_LANDMARKS), UPPER_LIDS)  # these are open as those of the other eye are
    np.testing.assert_allclose(tracker.pdm.shape(result.shape_params)[modelled], result.shape[modelled])


def error_percent(found: np.ndarray, truth: np.ndarray) -> float:
    unit = np.linalg.norm(truth[36] - truth[45])
    return float(np.linalg.norm(found - truth, axis=1)[INNER].mean() / unit * 100)


BAD_IMAGES = {
    "one pixel": np.zeros((1, 1), np.uint8),
    "a row": np.full((1, 500, 3), 200, np.uint8),
    "sixteen by sixteen": np.random.default_rng(0).integers(0, 255, (16, 16, 3), np.uint8),
    "black": np.zeros((480, 640, 3), np.uint8),
    "white grey image": np.full((480, 640), 255, np.uint8),
    "noise": np.random.default_rng(1).integers(0, 255, (240, 320, 4), np.uint8),
    "16 bit": np.random.default_rng(2).integers(0, 65535, (120, 160, 3), np.uint16),
    "not a number": np.full((120, 160, 3), np.nan, np.float32),
    "infinite": np.full((120, 160), np.inf),
    "very wide": np.random.default_rng(3).integers(0, 255, (40, 4000), np.uint8),
    "huge": np.zeros((4320, 7680), np.uint8),
}


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_an_image_without_a_face_gives_no_face_and_no_exception(tracker: FaceTracker, name: str) -> None:
    for result in (tracker.locate(BAD_IMAGES[name]), tracker.track(BAD_IMAGES[name])):
        assert_keeps_its_promises(tracker, result)
        assert not result.found


@settings(max_examples=25)
@given(
    image=hnp.arrays(
        st.sampled_from([np.uint8, np.uint16, np.float32]),
        st.one_of(
            st.tuples(st.integers(1, 60), st.integers(1, 60)),
            st.tuples(st.integers(1, 60), st.integers(1, 60), st.sampled_from([1, 3, 4])),
        ),
    )
)
def test_any_image_gives_a_result(tracker: FaceTracker, image: np.ndarray) -> None:
    if image.dtype == np.float32:
        image = np.where(np.abs(image) > 1.0, np.float32(1.0), image)  # larger numbers are refused
    assert_keeps_its_promises(tracker, tracker.track(image))


def test_invalid_images_are_user_errors(tracker: FaceTracker) -> None:
    for wrong in (np.zeros((3, 4, 7)), np.zeros(5), np.zeros((0, 10), np.uint8), np.zeros((4, 4), np.complex128)):
        with pytest.raises(FacemimeError):
            tracker.track(wrong)


@needs_photos
def test_a_held_out_face_is_found_within_three_percent(
    tracker: FaceTracker, photo: tuple[np.ndarray, np.ndarray]
) -> None:
    image, truth = photo
    result = tracker.locate(image)
    assert_keeps_its_promises(tracker, result)
    assert result.found
    assert error_percent(result.landmarks, truth) < 3.0


@needs_photos
def test_grey_colour_and_float_images_give_the_same_face(
    tracker: FaceTracker, photo: tuple[np.ndarray, np.ndarray]
) -> None:
    image, _ = photo
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    of_colour, of_grey = tracker.locate(image), tracker.locate(grey)
    of_float = tracker.locate(grey.astype(np.float32) / 255.0)
    np.testing.assert_allclose(of_colour.landmarks, of_grey.landmarks)
    np.testing.assert_allclose(of_float.landmarks, of_grey.landmarks, atol=1e-6)


@needs_photos
def test_a_tilted_head_is_found_and_its_roll_reported(
    tracker: FaceTracker, photo: tuple[np.ndarray, np.ndarray]
) -> None:
    image, truth = photo
    middle = (image.shape[1] / 2, image.shape[0] / 2)
    for degrees in (-30.0, 30.0):
        matrix = cv2.getRotationMatrix2D(middle, -degrees, 0.9)
        turned = cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        result = tracker.locate(turned)
        assert result.found
        assert error_percent(result.landmarks, truth @ matrix[:, :2].T + matrix[:, 2]) < 5.0
        assert np.degrees(result.pose[3]) == pytest.approx(degrees, abs=6.0)


@needs_photos
def test_a_moving_face_is_tracked_without_detection(tracker: FaceTracker, photo: tuple[np.ndarray, np.ndarray]) -> None:
    image, truth = photo
    tracker.reset()
    for frame in range(6):
        move = np.float32([[1, 0, 7 * frame], [0, 1, -4 * frame]])
        moved = cv2.warpAffine(image, move, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        result = tracker.track(moved)
        assert result.found
        assert error_percent(result.landmarks, truth + move[:, 2]) < 4.0
        assert (tracker.timings["detect"] > 0) == (frame == 0)


@needs_photos
def test_a_face_that_vanishes_is_lost_and_found_again_when_it_returns(
    tracker: FaceTracker, photo: tuple[np.ndarray, np.ndarray]
) -> None:
    image, _ = photo
    tracker.reset()
    assert tracker.track(image).found
    assert not tracker.track(np.full_like(image, 120)).found
    assert tracker.track(image).found


@needs_photos
def test_locating_does_not_affect_tracking(tracker: FaceTracker, photo: tuple[np.ndarray, np.ndarray]) -> None:
    image, _ = photo
    tracker.reset()
    tracker.track(image)
    expected = tracker.track(image).landmarks
    tracker.reset()
    tracker.track(image)
    tracker.locate(np.full((50, 50), 128, np.uint8))
    np.testing.assert_array_equal(tracker.track(image).landmarks, expected)


@pytest.fixture(scope="module")
def two_faces(photo: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An image with a small face on the left and a large one, and the landmarks of each."""
    image, truth = photo
    small = cv2.resize(image, None, fx=0.55, fy=0.55, interpolation=cv2.INTER_AREA)
    both = np.full((image.shape[0], image.shape[1] + small.shape[1], 3), 200, np.uint8)
    both[: small.shape[0], : small.shape[1]] = small
    both[:, small.shape[1] :] = image
    return both, (truth + 0.5) * 0.55 - 0.5, truth + (small.shape[1], 0)


@needs_photos
def test_the_chosen_face_is_tracked_even_if_another_is_larger(
    tracker: FaceTracker, two_faces: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    both, small, _ = two_faces
    tracker.reset()
    tracker.choose(*small.mean(0))
    for _ in range(3):
        assert error_percent(tracker.track(both).landmarks, small) < 5.0


@needs_photos
def test_a_lost_face_is_awaited_before_another_is_taken(
    tracker: FaceTracker, two_faces: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    both, small, large = two_faces
    hidden = both.copy()
    hidden[:, : int(large[:, 0].min()) - 30] = 120
    tracker.reset()
    tracker.choose(*small.mean(0))
    assert tracker.track(both).found
    for _ in range(4):
        assert not tracker.track(hidden).found
    assert error_percent(tracker.track(both).landmarks, small) < 5.0
    results = [tracker.track(hidden) for _ in range(80)]
    assert error_percent(results[-1].landmarks, large) < 5.0


@needs_photos
def test_of_two_faces_the_larger_is_taken(
    tracker: FaceTracker, two_faces: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    both, _, large = two_faces
    assert error_percent(tracker.locate(both).landmarks, large) < 4.0


def test_a_second_thread_changes_no_result_and_ends_with_its_context():
    portrait = read_image(PORTRAIT)
    one, two = FaceTracker.load(), FaceTracker.load()
    with two.in_two_threads():
        for shift in range(4):
            image = np.roll(portrait, shift, axis=1)
            alone, beside = one.track(image), two.track(image)
            for name in ("landmarks", "pupils", "gaze", "actions"):
                np.testing.assert_array_equal(getattr(beside, name), getattr(alone, name))
            assert beside.confidence == alone.confidence > 0.9
        assert [thread for thread in threading.enumerate() if thread.name.startswith("facemime-networks")]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("facemime-networks")]
    assert two.track(portrait).found


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda tracker: pickle.loads(pickle.dumps(tracker))])
def test_a_tracker_can_be_copied_and_sent_to_another_process(copied):
    tracker, face = FaceTracker.load(), read_image(PORTRAIT)
    assert tracker.track(face).found
    other = copied(tracker)
    np.testing.assert_array_equal(other.track(face).landmarks, tracker.track(face).landmarks)
