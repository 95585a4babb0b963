"""Preparation of training data for the tracker."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.face.landmarks import LIPS, LOWER_LIPS, UPPER_LIPS
from facemime.core.face.names import ACTIONS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.mesh.triangles import rasterise
from facemime.core.tracking.tracker import FaceTracker
from lab.training.data import DATA, has_heads
from lab.training.tracker.acting import ActionSamples
from lab.training.tracker.crops import ActionPart, draw_actions
from lab.training.tracker.heads import load_ict, sample_speech
from lab.training.tracker.organs import random_eyes, tongue_out
from lab.training.tracker.patches import mirror_samples
from lab.training.tracker.pupils import EYES, PupilCrops, PupilSamples
from lab.training.tracker.samples import SIZE, Samples, degrade
from lab.training.tracker.sources import Photo, held_out_people, mirrored, person_of, split
from lab.training.tracker.wrinkles import crease


def photo(source: str, name: str) -> Photo:
    return Photo(source, name, person_of(source, name), Path(name), np.zeros((66, 2)))


def test_both_photos_of_a_person_are_on_the_same_side_of_the_split() -> None:
    london = [f"{n:03d}" for n in range(1, 180)]
    photos = [photo("london_neutral", f"{n}_03.jpg") for n in london]
    photos += [photo("london_smiling", f"{n}_08.jpg") for n in london]
    train, held = split(photos)
    assert len(train) + len(held) == len(photos)
    assert not {p.person for p in train} & {p.person for p in held}
    assert len(held) == 40


def test_twenty_people_of_london_and_seven_of_canada_are_held_out() -> None:
    sources = [person.split(":")[0] for person in held_out_people()]
    assert (sources.count("london"), sources.count("canada")) == (20, 7)


def test_mirroring_a_labelled_image_twice_restores_it() -> None:
    rng = np.random.default_rng(0)
    image, landmarks = rng.integers(0, 255, (90, 120), np.uint8), rng.uniform(0, 100, (66, 2))
    again, points = mirrored(*mirrored(image, landmarks))
    np.testing.assert_array_equal(again, image)
    np.testing.assert_allclose(points, landmarks)


def test_mirroring_samples_twice_restores_them() -> None:
    rng = np.random.default_rng(1)
    samples = Samples(
        rng.integers(0, 255, (2, SIZE, SIZE), np.uint8),
        rng.uniform(0, SIZE, (2, 66, 2)).astype(np.float32),
        rng.random((2, 66)) < 0.5,
        rng.normal(0, 1, (2, 6)).astype(np.float32),
        np.zeros((2, 4), np.float32),
        np.ones(2, np.float32),
    )
    again = mirror_samples(mirror_samples(samples))
    np.testing.assert_array_equal(again.images, samples.images)
    np.testing.assert_allclose(again.landmarks, samples.landmarks, atol=1e-4)
    np.testing.assert_allclose(again.poses, samples.poses, atol=1e-4)
    np.testing.assert_array_equal(again.visible, samples.visible)


def test_an_action_is_learnt_on_the_side_where_it_is_seen_in_mirrored_images_too() -> None:
    """The pressed corner of this mouth is the performer's right one, and bright."""
    pdm = FaceTracker.load().pdm
    pose = np.array([80.0, 0.0, 0.0, 0.0, SIZE / 2, SIZE / 2])
    landmarks, image = pdm.project(pose, np.zeros(pdm.n_modes)), np.full((1, SIZE, SIZE), 60, np.uint8)
    image[0, :, : int(landmarks[LIPS, 0].mean())] = 200
    right, left = (ACTIONS.index(f"mouthPress{side}") for side in ("Right", "Left"))
    shown = np.zeros(len(ACTIONS))
    shown[right] = 1.0
    stacked = [np.float32(values)[None] for values in (landmarks, pose, shown)]
    samples = ActionSamples(image, *stacked, np.full((1, 2, 2), np.nan, np.float32), np.zeros(1, np.int32))
    part = ActionPart(np.array([right, left]), np.array([48, 54, 57]), 44.0, (64, 56), False)
    drawn = draw_actions(samples, part, 64, np.random.default_rng(3))
    brighter = [picture[:, :16].mean() > picture[:, -16:].mean() for picture in drawn.pictures[:, 0]]
    assert (drawn.actions.sum(axis=1) == 1.0).all() and 0 < drawn.actions[:, 0].sum() < 64
    assert np.mean(brighter == (drawn.actions[:, 0] == 1.0)) > 0.95  # a few are covered by something in front


def test_pupils_are_learnt_where_they_are_in_mirrored_and_misplaced_images_too() -> None:
    outlines = np.array([[[34, 64], [40, 60], [48, 60], [54, 64], [48, 67], [40, 67]]], np.float32)
    eyes = np.concatenate([outlines, outlines + (40.0, 0.0)])
    pupils = np.array([[42.0, 63.0], [83.0, 64.0]], np.float32)
    image = np.full((EYES, EYES), 230, np.uint8)
    for x, y in pupils:
        cv2.circle(image, (round(x), round(y)), 4, 20, -1)
    hidden = np.float32([pupils[0], [np.nan, np.nan]])
    samples = PupilSamples(np.stack([image] * 2), np.stack([eyes] * 2), np.stack([pupils, hidden]))
    crops = PupilCrops({"renders": samples, "photos": samples}, np.random.default_rng(5))
    batch = crops.batch(60, 60.0, (80, 24))
    seen, shown = [], int(batch.known.sum())
    for (picture,), pupils, known in zip(batch.pictures, batch.pupils, batch.known > 0.0, strict=True):
        for x, y in 24 * pupils[known] + (39.5, 11.5):
            around = picture[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2]
            seen.append(around.mean() < np.quantile(picture, 0.2))
    assert 60 < shown < 120  # one pupil of half of the images is hidden
    assert np.mean(seen) > 0.8  # others are covered or spoilt


def test_the_rasteriser_fills_a_triangle_and_lets_the_nearer_one_win() -> None:
    points = np.array([[2.0, 3.0], [27.0, 5.0], [8.0, 25.0], [0.5, 0.5], [30.5, 0.5], [0.5, 30.5]])
    depth = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    drawn = rasterise(points, depth, np.array([[3, 4, 5], [0, 1, 2]]), 32)
    shown = np.full(32 * 32, -1)
    shown[drawn.pixel] = drawn.triangle

    def inside(corners: np.ndarray) -> np.ndarray:
        y, x = np.mgrid[0:32, 0:32]
        (ax, ay), (bx, by), (cx, cy) = corners
        sides = [
            (qx - px) * (y - py) - (qy - py) * (x - px)
            for px, py, qx, qy in ((ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay))
        ]
        return (np.stack(sides) >= 0).all(0)

    expected = np.where(inside(points[:3]), 1, np.where(inside(points[3:]), 0, -1))
    assert (shown.reshape(32, 32) != expected).mean() < 0.01
    np.testing.assert_allclose(drawn.barycentric.sum(1), 1.0, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_degrading_keeps_the_size_and_type_of_an_image(seed: int) -> None:
    rng = np.random.default_rng(seed)
    out = degrade(rng.integers(0, 255, (SIZE, SIZE), np.uint8), rng)
    assert out.shape == (SIZE, SIZE)
    assert out.dtype == np.uint8


def lips() -> np.ndarray:
    landmarks = FaceTracker.load().pdm.mean_shape.copy()
    landmarks[LOWER_LIPS, 1] += 0.12
    return landmarks


@pytest.mark.parametrize("amount", [0.2, 0.6, 1.0])
def test_a_tongue_reaches_out_between_the_lips_the_further_the_more_it_is_out(amount: float) -> None:
    landmarks = lips()
    tongue = tongue_out(landmarks, amount, np.random.default_rng(3))
    reach = np.ptp(tongue.vertices[:, 1:], axis=0).max()
    assert reach > 0.2 + 0.2 * amount
    foremost = tongue.vertices[np.argmin(tongue.vertices[:, 2])]
    assert foremost[2] < landmarks[LIPS, 2].min()
    assert tongue.vertices[:, 1].max() > landmarks[UPPER_LIPS, 1].max()


def test_the_surface_of_a_tongue_faces_outwards() -> None:
    tongue = tongue_out(lips(), 0.7, np.random.default_rng(1))
    a, b, c = (tongue.vertices[tongue.triangles[:, i]].astype(float) for i in range(3))
    middle = tongue.vertices.mean(axis=0)
    # Seen from outside, triangles of a face in the head frame are clockwise, as y points down.
    assert np.einsum("td,td->", np.cross(b - a, c - a), (a + b + c) / 3 - middle) > 0.0


def test_a_painted_eye_is_dark_where_it_looks() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(0, 1, (4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    eyes = replace(random_eyes(rng), gaze=np.array([[0.1, -0.4], [0.1, 0.4]]), white=1.2, iris=60.0, shadow=0.0)
    for side, (pitch, yaw) in enumerate(eyes.gaze):
        grey = eyes.paint(side, ball, ball, 150.0)
        darkest = ball[grey < 50.0].mean(axis=0)
        looking = euler_to_matrix(pitch, yaw, 0.0) @ (0.0, 0.0, -1.0)
        assert darkest @ looking / np.linalg.norm(darkest) > np.cos(np.radians(8.0))


def test_creases_are_drawn_where_an_action_is_and_only_on_the_face() -> None:
    landmarks = FaceTracker.load().pdm.mean_shape[:, :2] * 80.0 + 135.5
    plain = np.full((SIZE, SIZE), 128, np.uint8)
    drawn = crease(plain, landmarks, 80.0, {"noseSneer_R": 1.0, "noseSneer_L": 1.0}, np.random.default_rng(4))
    changed = np.argwhere(drawn != plain)[:, ::-1]
    assert len(changed) > 50
    low, high = landmarks.min(axis=0) - 40.0, landmarks.max(axis=0) + 5.0
    assert ((changed > low) & (changed < high)).all()


@pytest.mark.skipif(not has_heads(DATA), reason="../shared/data/heads is missing")
def test_speaking_mouths_are_open_or_bare_the_teeth_of_a_shut_jaw_or_are_shut() -> None:
    head, rng = load_ict(DATA), np.random.default_rng(7)
    at_rest = head.neutral[head.landmarks]
    spoken = np.array([sample_speech(head, rng) for _ in range(400)])
    moved = at_rest + np.tensordot(spoken, head.expression[:, head.landmarks], 1)
    gaps = (moved[:, LOWER_LIPS] - moved[:, UPPER_LIPS])[..., 1].mean(axis=1)
    gaps -= (at_rest[LOWER_LIPS] - at_rest[UPPER_LIPS])[:, 1].mean()
    shut_jaw, apart = spoken[:, head.index("jawOpen")] < 0.13, gaps > 0.06
    assert (shut_jaw & apart).mean() > 0.2
    assert (gaps < 0.02).mean() > 0.2
    assert (~shut_jaw & apart).mean() > 0.2
