"""The network that finds faces: its output, its training scenes, and the tracker that uses it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.files.capture import read_image
from facemime.core.tracking.fitter import COARSE
from facemime.core.tracking.network import LARGEST, OUTPUTS, SMALLEST, STRIDE, UNIT, Detection, NetworkDetector
from facemime.core.tracking.tracker import CASCADES, FaceTracker, TrackingSettings
from lab.training.tracker.detection import SCENE, Heads, SceneBatch, Scenes, mark
from tests.helpers.thorough import first_of

PORTRAITS = Path(__file__).resolve().parents[2] / "data" / "portraits"
DATA = Path(__file__).parents[4] / "shared" / "data"
needs_photos = pytest.mark.skipif(not DATA.exists(), reason="the photographs of ../shared/data are not here")
CELLS = SCENE // STRIDE


class Stated:
    """Returns the outputs that the training asks of a network for a scene with one face."""

    def __init__(self, pose: np.ndarray, rim: int) -> None:
        shape = (1, 1, CELLS, CELLS)
        batch = SceneBatch(
            np.empty((1, 1, SCENE, SCENE)), np.zeros(shape), np.ones(shape), np.zeros((1, 7, *shape[2:]))
        )
        mark(batch, 0, pose + [0, 0, 0, 0, rim, rim])
        self.out = np.concatenate([np.where(batch.face > 0, 5.0, -9.0), batch.found], axis=1).astype(np.float32)

    def __call__(self, pictures: np.ndarray) -> tuple[np.ndarray, ...]:
        assert pictures.shape == (1, SCENE, SCENE)
        return (self.out,)


@given(
    size=st.floats(SMALLEST, LARGEST),
    pitch=st.floats(-0.8, 0.8),
    yaw=st.floats(-1.5, 1.5),
    roll=st.floats(-3.1, 3.1),
    x=st.floats(0, 127),
    y=st.floats(0, 127),
)
def test_a_face_is_read_where_training_marks_it(size, pitch, yaw, roll, x, y):
    pose, rim = np.array([size, pitch, yaw, roll, x, y]), 16
    detector = NetworkDetector(Stated(pose, rim))
    (found,) = detector.detect(np.zeros((SCENE - 2 * rim, SCENE - 2 * rim), np.uint8), (SCENE,))
    np.testing.assert_allclose(found.pose, pose, atol=2e-3)
    assert len(detector.network.out[0]) == 1 + len(OUTPUTS)


def test_the_labels_of_a_training_scene_match_its_image():
    # A head with a bright spot on the side that it turns to; the stated pose should tell where the spot is.
    image = np.full((1, 136, 136), 40, np.uint8)
    cv2.circle(image[0], (92, 68), 9, 255, -1)
    pose = np.float32([[40.0, 0.0, 0.6, 0.0, 68.0, 68.0]])
    heads = Heads(image, np.ones_like(image, bool), pose, np.array([False]))
    heads = Heads.join([heads, Heads(image, np.ones_like(image, bool), pose, np.array([True]))])
    batch = Scenes(heads, [np.full((160, 160), 40, np.uint8)], np.random.default_rng(4)).draw(80)
    assert 0.1 < (batch.face.max(axis=(1, 2, 3)) == 0).mean() < 0.5, "scenes without a face"
    shown = []
    for row, _, *cell in np.argwhere(batch.face > 0):
        x, y, size, c, s, yaw, _ = batch.found[row, :, cell[0], cell[1]]
        middle = (np.array(cell[::-1]) + 0.5) * STRIDE - 0.5 + UNIT * np.array([x, y])
        spot = middle + 24.0 / 40.0 * UNIT * np.exp(size) * np.sign(yaw) * np.array([c, s])
        if (spot > 2).all() and (spot < SCENE - 3).all():
            picture = batch.pictures[row, 0]
            shown.append(picture[tuple(np.round(spot).astype(int)[::-1])] > picture.mean() + picture.std())
    assert len(shown) > 50 and np.mean(shown) > 0.95


@pytest.mark.parametrize("name", ["collins.jpg", "hopper.jpg"])
@pytest.mark.parametrize(
    ("scale", "degrees", "turns"),
    [(1.0, 0, 0), (0.3, 0, 0), (0.5, 40, 0), (0.5, -60, 0), (0.5, 80, 1), (0.5, 190, 2), (0.5, -100, 3)],
)
def test_the_likeliest_face_of_a_portrait_is_where_the_tracker_fits_it(tracker, name, scale, degrees, turns):
    image = cv2.cvtColor(read_image(PORTRAITS / name), cv2.COLOR_BGR2GRAY)
    fitted = tracker.locate(image).pose
    height, width = image.shape
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), -degrees, scale)
    seen = cv2.warpAffine(image, turn, (width, height), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE)
    found = tracker._model.detector.detect(seen, turns=turns)[0].pose
    assert np.hypot(*(found[4:6] - turn @ [*fitted[4:6], 1.0])) < 0.35 * scale * fitted[0]
    assert abs(np.log(found[0] / (scale * fitted[0]))) < 0.3
    away = np.degrees(found[3] - fitted[3]) - degrees
    assert abs((away + 180) % 360 - 180) < 25


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_an_image_on_its_side_or_upside_down_gives_the_same_landmarks(tracker, turns):
    image = read_image(PORTRAITS / "hopper.jpg")
    upright, turned = tracker.locate(image), tracker.locate(np.ascontiguousarray(np.rot90(image, turns)))
    assert turned.found and turned.confidence > 0.85
    back = turned.landmarks - (np.array(np.rot90(image, turns).shape[1::-1]) - 1) / 2.0
    back = back @ np.linalg.matrix_power([[0.0, 1.0], [-1.0, 0.0]], turns) + (np.array(image.shape[1::-1]) - 1) / 2.0
    assert np.linalg.norm(back - upright.landmarks, axis=1).mean() < 0.02 * upright.pose[0]


@pytest.mark.parametrize("size", [(1, 1), (3, 900), (480, 640), (17, 31)])
def test_an_image_of_any_size_can_be_searched(tracker, size):
    grey = np.random.default_rng(0).integers(0, 256, size, np.uint8)
    assert all(np.isfinite(face.pose).all() and face.pose[0] > 0 for face in tracker._model.detector.detect(grey))


def test_viola_jones_alone_finds_the_same_face_without_the_network(monkeypatch, tracker):
    image = read_image(PORTRAITS / "hopper.jpg")
    by_network = tracker.locate(image)
    monkeypatch.delattr(NetworkDetector, "detect")
    with pytest.raises(AttributeError):
        tracker.locate(image)
    alone = FaceTracker.load(settings=TrackingSettings(CASCADES)).locate(image)
    assert np.linalg.norm(by_network.landmarks - alone.landmarks, axis=1).mean() < 0.01 * alone.pose[0]


@needs_photos
@pytest.mark.parametrize("degrees", first_of([0, 45, 60, 70], 2))
def test_a_person_turning_away_in_front_is_preferred_to_somebody_behind(degrees):
    from lab.bench.detection import Case, Renderer

    tracker = FaceTracker.load()
    picture, landmarks, seen = Renderer(DATA, tracker).picture(Case("", yaw=degrees, behind=True), 1)
    found = tracker.track(picture)
    assert found.found
    assert np.linalg.norm(found.landmarks - landmarks, axis=1)[seen].mean() < 0.1 * 80


def test_a_live_frame_tries_few_unlikely_detections_and_all_of_them_in_turn(monkeypatch):
    tracker, tried = FaceTracker.load(gradual=True), []
    places = [np.array([40.0, 0.0, 0.0, 0.0, 60.0 + 65.0 * i, 240.0]) for i in range(8)]
    monkeypatch.setattr(NetworkDetector, "detect", lambda *_: [Detection(place, -0.5) for place in places])
    fit = tracker.search.fitter.fit

    def counted(grey, start, rounds):
        if rounds == (COARSE,):
            tried[-1].append(round(float(start.pose[4])))
        return fit(grey, start, rounds)

    monkeypatch.setattr(tracker.search.fitter, "fit", counted)
    monkeypatch.setattr(tracker.search, "_boxes", lambda *_: [])
    nobody = np.random.default_rng(1).integers(0, 256, (480, 640), np.uint8)
    for _ in range(16):
        tried.append([])
        assert not tracker.track(nobody).found
    assert max(map(len, tried)) == 2
    assert {place for frame in tried for place in frame} == {round(float(place[4])) for place in places}
