"""The tracker on photographs of people with hand-placed landmarks, in the public domain and in the repository."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.face.landmarks import LIPS, MIRROR, from_ibug, outer_eye_distance
from facemime.core.face.names import N_ACTIONS
from facemime.core.files.capture import read_image
from facemime.core.tracking.cascade_detector import CascadeDetector
from facemime.core.tracking.network import NetworkDetector
from facemime.core.tracking.result import is_hidden
from facemime.core.tracking.tracker import CASCADES, NETWORK, FaceTracker, TrackingSettings

PORTRAITS = Path(__file__).resolve().parents[2] / "data" / "portraits"
LABELS = json.loads((PORTRAITS / "labels.json").read_text())


@pytest.mark.parametrize(("name", "mean"), [("collins.jpg", 0.045), ("hopper.jpg", 0.065)])
def test_landmarks_lie_where_a_hand_marked_them(tracker, name, mean):
    found = tracker.locate(read_image(PORTRAITS / name))
    numbers, places = [int(number) for number in LABELS[name]], np.array(list(LABELS[name].values()))
    away = np.linalg.norm(found.landmarks[from_ibug(numbers)] - places, axis=1) / outer_eye_distance(found.landmarks)
    assert found.confidence > 0.9
    assert away.mean() < mean and away.max() < 0.12, dict(zip(numbers, away.round(3).tolist(), strict=True))


@pytest.mark.parametrize("name", LABELS)
def test_a_mirrored_photograph_gives_mirrored_landmarks(tracker, name):
    image = read_image(PORTRAITS / name)
    one, other = tracker.locate(image).landmarks, tracker.locate(np.ascontiguousarray(image[:, ::-1])).landmarks
    mirrored = (other * (-1.0, 1.0) + (image.shape[1] - 1.0, 0.0))[MIRROR]
    assert np.linalg.norm(one - mirrored, axis=1).mean() < 0.03 * outer_eye_distance(one)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_the_size_of_a_photograph_makes_little_difference(tracker, scale):
    image = read_image(PORTRAITS / "hopper.jpg")
    one = tracker.locate(image).landmarks
    scaled = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    other = (tracker.locate(scaled).landmarks + 0.5) / scale - 0.5
    assert np.linalg.norm(one - other, axis=1).mean() < 0.03 * outer_eye_distance(one)


def with_raised_brows(image: np.ndarray, landmarks: np.ndarray, height: float, sides: tuple[int, ...]) -> np.ndarray:
    """The photograph with the skin of the brows moved up by `height` eye distances on the given sides of the face."""
    unit = outer_eye_distance(landmarks)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    shift = np.zeros_like(y)
    for side in sides:
        brow = landmarks[from_ibug(range(17, 22) if side == 0 else range(22, 27))]
        lid = landmarks[from_ibug((37, 38) if side == 0 else (43, 44))]
        across = np.exp(-(np.maximum(np.abs(x - brow[:, 0].mean()) / unit - 0.3, 0.0) ** 2) / (2 * 0.1**2))
        # From nothing at the upper lid to the full height at the brow, and decreasing again up the forehead.
        low, high = lid[:, 1].mean() - 0.03 * unit, brow[:, 1].mean() - (height - 0.05) * unit
        up = np.interp(y, [high - 3.0 * height * unit, high, low], [0.0, 1.0, 0.0])
        shift = np.maximum(shift, across * up * height * unit)
    return cv2.remap(image, x, (y + shift).astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize(("sides", "height"), [((0,), 0.2), ((1,), 0.2), ((0, 1), 0.25)])
def test_brows_that_are_raised_high_at_once_are_followed(tracker, sides, height):
    image = read_image(PORTRAITS / "collins.jpg")
    tracker.reset()
    rest = tracker.track(image).landmarks
    raised = with_raised_brows(image, rest, height, sides)
    for _ in range(3):
        followed = tracker.track(raised).landmarks
    for side, brow in enumerate((from_ibug(range(18, 21)), from_ibug(range(23, 26)))):
        risen = (rest[brow, 1] - followed[brow, 1]).mean() / outer_eye_distance(rest)
        assert risen > 0.1 if side in sides else abs(risen) < 0.05


def with_a_hand(image: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """The photograph with four skin-coloured fingers over the mouth."""
    unit, out = outer_eye_distance(landmarks), image.copy()
    centre, skin = landmarks[LIPS].mean(axis=0), image[tuple(landmarks[12].astype(int)[::-1])]
    for row in range(-2, 3):
        middle = centre + (0.0, 0.16 * row * unit)
        first, last = ((middle + (across * unit, 0.0)).astype(int).tolist() for across in (-0.9, 0.45))
        for width, shade in ((0.17, 0.45), (0.13, 0.8 + 0.05 * row)):
            colour = [min(float(value) * shade, 255.0) for value in skin]
            cv2.line(out, first, last, colour, max(int(width * unit), 1), cv2.LINE_AA)
    return out


def test_a_mouth_behind_a_hand_keeps_its_shape_and_recovers_in_the_next_frame(tracker):
    image = read_image(PORTRAITS / "collins.jpg")
    tracker.reset()
    before = tracker.track(image)
    covered = [tracker.track(with_a_hand(image, before.landmarks)) for _ in range(5)]
    assert all(result.found and is_hidden(result.landmark_confidence) for result in covered)
    assert max(abs(result.mouth_aperture - before.mouth_aperture) for result in covered) < 0.02
    assert np.isfinite(before.teeth) and np.isnan([result.teeth for result in covered]).all()
    again = [tracker.track(image) for _ in range(2)][-1]
    assert not is_hidden(again.landmark_confidence)
    assert np.linalg.norm(again.landmarks - before.landmarks, axis=1).mean() < 0.01 * outer_eye_distance(
        again.landmarks
    )


def lying(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.rot90(image))


def far(image: np.ndarray) -> np.ndarray:
    """The photograph in the corner of a large grey image."""
    out = np.full((1080, 1920, 3), 120, np.uint8)
    small = cv2.resize(image, None, fx=320 / image.shape[0], fy=320 / image.shape[0], interpolation=cv2.INTER_AREA)
    out[-small.shape[0] :, -small.shape[1] :] = small
    return out


@pytest.mark.parametrize("shown", [np.asarray, lying, far])
def test_a_gradual_search_finds_a_face_within_its_cycle_where_a_full_one_does_at_once(tracker, shown):
    image = shown(read_image(PORTRAITS / "collins.jpg"))
    at_once = tracker.locate(image)
    assert at_once.found
    gradual = FaceTracker.load(gradual=True)
    results = (gradual.track(image) for _ in range(80))
    found = next(result for result in results if result.found)
    assert np.linalg.norm(found.landmarks - at_once.landmarks, axis=1).mean() < 0.05 * outer_eye_distance(
        at_once.landmarks
    )


@pytest.mark.parametrize("shown", [np.asarray, lying, far])
def test_who_comes_into_the_view_of_a_file_is_found_as_soon_as_live(tracker, shown):
    image = shown(read_image(PORTRAITS / "collins.jpg"))
    counts = []
    for searching in (FaceTracker.load(), FaceTracker.load(gradual=True)):
        for _ in range(9):
            assert not searching.track(np.full(image.shape, 128, np.uint8)).found
        counts.append(next(frame for frame in range(80) if searching.track(image).found))
    in_a_file, live = counts
    assert in_a_file <= live


@pytest.mark.parametrize(
    ("gradual", "detector", "most"), [(True, NETWORK, 1), (True, CASCADES, 3), (False, NETWORK, 1)]
)
def test_no_frame_without_a_face_exceeds_its_budget_of_work(monkeypatch, gradual, detector, most):
    made = []
    scanned = CascadeDetector._scanned
    monkeypatch.setattr(
        CascadeDetector, "_scanned", lambda self, picture, scan: made.append(scan) or scanned(self, picture, scan)
    )
    tracker = FaceTracker.load(gradual=gradual, settings=TrackingSettings(detector))
    nobody = np.full((480, 640), 128, np.uint8)
    counts = []
    for _ in range(40):
        made.clear()
        assert not tracker.track(nobody).found
        counts.append(len(made))
    assert max(counts if gradual else counts[1:]) == most


@pytest.mark.parametrize("gradual", [True, False])
def test_a_frame_without_a_face_takes_one_pass_of_the_network_or_one_scan(monkeypatch, gradual):
    made = []
    detect, scanned = NetworkDetector.detect, CascadeDetector._scanned
    monkeypatch.setattr(NetworkDetector, "detect", lambda self, *of: made.append("pass") or detect(self, *of))
    monkeypatch.setattr(CascadeDetector, "_scanned", lambda self, *of: made.append("scan") or scanned(self, *of))
    tracker = FaceTracker.load(gradual=gradual)
    counts = []
    for _ in range(12):
        made.clear()
        assert not tracker.track(np.full((480, 640), 128, np.uint8)).found
        counts.append(len(made))
    assert set(counts if gradual else counts[1:]) == {1}


def test_actions_of_eyes_and_mouth_are_measured_alternately_live_and_in_every_frame_of_files(tracker):
    image = read_image(PORTRAITS / "hopper.jpg")
    gradual, whole = FaceTracker.load(gradual=True), FaceTracker.load()
    (eye,) = (part for part in tracker._model.actions if part.paired)
    of_eye = np.isin(np.arange(N_ACTIONS), eye.measured)
    while not (last := gradual.track(image)).found:
        pass
    assert np.isfinite(last.actions).all()
    noise = np.random.default_rng(0)
    for _ in range(6):
        spoilt = np.clip(image + noise.normal(0, 20, image.shape), 0, 255).astype(np.uint8)
        now = gradual.track(spoilt)
        changed = now.actions != last.actions
        assert changed[of_eye].all() != changed[~of_eye].all()
        last = now
        before, after = (whole.track(picture).actions for picture in (image, spoilt))
        assert (before != after).all()
