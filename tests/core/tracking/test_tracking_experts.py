"""Convolutional experts, their input crops, and the frame of their maps."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.errors import ModelError
from facemime.core.face.landmarks import MIRROR
from facemime.core.face.names import ACTION_MIRROR, N_ACTIONS
from facemime.core.files.capture import read_image
from facemime.core.tracking.experts import ResponseMaps, standardise
from facemime.core.tracking.model_file import TrackerModel, load_model
from facemime.core.tracking.network import Network
from facemime.core.tracking.patch_experts import measure_actions
from facemime.core.tracking.reference import pose_in_image, warp_to_reference
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker

PORTRAITS = Path(__file__).resolve().parents[2] / "data" / "portraits"


@pytest.fixture(scope="module")
def model() -> TrackerModel:
    return load_model(DEFAULT_MODEL)


def picture(seed: int, height: int = 300, width: int = 400) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 4.0), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def maps_of(probability: np.ndarray, corner: tuple[float, float], stride: float) -> ResponseMaps:
    count = len(probability)
    whole = (probability / probability.sum((1, 2), keepdims=True)).astype(np.float32)
    corners = np.tile(np.float32(corner), (count, 1))
    return ResponseMaps(np.arange(count), whole, corners, np.full((count, 1), stride, np.float32))


def test_the_moments_of_a_map_are_weighted_moments_of_its_cells() -> None:
    maps = maps_of(np.random.default_rng(0).random((4, 7, 5)), (-0.4, 1.5), 0.1)
    mean, variance = maps.moments
    y, x = np.mgrid[0:7, 0:5]
    places = np.stack([x, y], -1) * 0.1 + (-0.4, 1.5)
    for i in range(4):
        expected = (maps.likelihood[i, ..., None] * places).sum((0, 1))
        np.testing.assert_allclose(mean[i], expected, atol=1e-5)
        spread = (maps.likelihood[i] * ((places - expected) ** 2).sum(-1)).sum()
        assert variance[i] == pytest.approx(spread, rel=1e-3)


def test_the_separable_mean_shift_is_the_weighted_mean_of_the_paper() -> None:
    rng = np.random.default_rng(1)
    maps = maps_of(rng.random((5, 9, 8)), (3.0, -2.0), 0.5)
    landmarks = (3.0, -2.0) + rng.uniform(1, 3, (5, 2))
    shift = maps.shifts(landmarks, 0.6)
    y, x = np.mgrid[0:9, 0:8]
    places = np.stack([x, y], -1) * 0.5 + (3.0, -2.0)
    for i in range(5):
        near = np.exp(-((places - landmarks[i]) ** 2).sum(-1) / 1.2) * maps.likelihood[i]
        mean = (near[..., None] * places).sum((0, 1)) / near.sum()
        np.testing.assert_allclose(shift[i], mean - landmarks[i], atol=1e-4)


def test_infinite_variance_goes_to_the_mean_of_the_map() -> None:
    maps = maps_of(np.random.default_rng(2).random((3, 8, 8)), (0.0, 0.0), 1.0)
    places = np.full((3, 2), 2.0)
    np.testing.assert_allclose(maps.shifts(places, np.inf), maps.moments[0] - places)
    np.testing.assert_allclose(maps.shifts(places, 1e9), maps.moments[0] - places, atol=1e-3)


def test_a_landmark_far_outside_its_map_does_not_move() -> None:
    maps = maps_of(np.ones((1, 9, 9)), (0.0, 0.0), 1.0)
    np.testing.assert_allclose(maps.shifts(np.array([[500.0, 500.0]]), 1.0), 0.0)


def test_brightness_and_contrast_do_not_change_what_the_experts_see() -> None:
    grey = picture(3)[:96, :96] // 4
    np.testing.assert_allclose(standardise(3 * grey + 30, 0.0), standardise(grey, 0.0), atol=1e-4)
    assert np.abs(standardise(np.full((96, 96), 77, np.uint8), 8.0)).max() == 0.0


def test_every_map_has_a_maximum_of_one(model: TrackerModel) -> None:
    pose = np.array([60.0, 0.1, -0.2, 0.3, 210.0, 130.0])
    faces = [experts.respond(picture(4), pose)[0] for experts in (model.face, model.glance)]
    shape = model.pdm.project(np.array([1.0, 0.1, -0.2, 0.0, 0.0, 0.0]), np.zeros(model.pdm.n_modes))
    for maps in (*faces, *(part.respond(picture(4), pose, shape) for part in model.parts)):
        np.testing.assert_array_equal(maps.likelihood.max((1, 2)), 1.0)
        assert maps.likelihood.min() >= 0.0


def test_paired_parts_swap_in_a_mirrored_image(model: TrackerModel) -> None:
    grey = picture(5)
    eye = next(p for p in model.parts if p.paired)
    shape = model.pdm.mean_shape[:, :2]
    flipped_shape = shape[MIRROR] * (-1.0, 1.0)
    pose = np.array([70.0, 0, 0, 0, 199.5, 150.0])
    maps = eye.respond(grey, pose, shape)
    mirrored = eye.respond(np.ascontiguousarray(grey[:, ::-1]), pose, flipped_shape)
    count = len(eye.landmarks)
    np.testing.assert_array_equal(maps.landmarks[count:], MIRROR[maps.landmarks[:count]])
    np.testing.assert_allclose(mirrored.moments[0][:count] * (-1.0, 1.0), maps.moments[0][count:], atol=5e-3)


def test_an_invalid_network_is_a_model_error() -> None:
    with pytest.raises(ModelError, match="cannot read a network"):
        Network(b"not a network", "maps")


@pytest.mark.parametrize("scale", [20.0, 60.0, 250.0])
def test_a_relative_pose_is_composed_with_the_start(model: TrackerModel, scale: float) -> None:
    start = np.array([scale, 0.1, -0.2, 0.3, 210.0, 130.0])
    relative = np.array([1.1, 0.2, 0.1, -0.05, 0.03, -0.02])
    coefficients = np.zeros(model.pdm.n_modes)
    in_face = model.pdm.project(relative, coefficients)
    c, s = np.cos(start[3]), np.sin(start[3])
    expected = scale * in_face @ np.array([[c, s], [-s, c]]) + start[4:6]
    np.testing.assert_allclose(model.pdm.project(pose_in_image(relative, start), coefficients), expected, atol=1e-9)


@pytest.mark.parametrize("scale", [30.0, 90.0, 190.0])
def test_a_spot_appears_where_the_similarity_maps_it(scale: float) -> None:
    grey = np.zeros((480, 640), np.uint8)
    spot = np.array([330.0, 220.0])
    cv2.circle(grey, (330, 220), max(int(scale / 12), 2), 255, -1)
    pose = np.array([scale, 0.0, 0.0, 0.4, 300.0, 240.0])
    frame = warp_to_reference(grey, pose, 40.0, (136, 120))
    y, x = np.mgrid[0 : frame.pixels.shape[0], 0 : frame.pixels.shape[1]]
    mass = frame.pixels / frame.pixels.sum()
    np.testing.assert_allclose(((mass * x).sum(), (mass * y).sum()), frame.linear @ spot + frame.offset, atol=0.25)


def test_a_face_outside_the_image_still_has_a_frame() -> None:
    grey = np.full((60, 80), 90, np.uint8)
    for place in ((-500.0, 20.0), (1e6, 1e6), (40.0, 30.0)):
        frame = warp_to_reference(grey, np.array([50.0, 0, 0, 0.1, *place]), 40.0, (136, 120))
        assert frame.pixels.shape == (120, 136)
        assert np.isfinite(frame.pixels).all()


@pytest.mark.parametrize(("scale", "x"), [(30.0, 200.0), (220.0, 180.0), (90.0, 395.0)])
def test_a_colour_image_is_cropped_as_each_of_its_channels(scale: float, x: float) -> None:
    colour = np.stack([picture(seed) for seed in range(3)], axis=2)
    pose = np.array([scale, 0.0, 0.0, 0.3, x, 120.0])
    cropped = warp_to_reference(colour, pose, 40.0, (96, 80)).pixels
    channels = [warp_to_reference(colour[..., k], pose, 40.0, (96, 80)).pixels for k in range(3)]
    np.testing.assert_allclose(cropped.astype(int), np.stack(channels, axis=2).astype(int), atol=1)


def test_the_experts_of_actions_measure_each_action_once(model) -> None:
    measured = np.concatenate([part.measured for part in model.actions])
    assert sorted(measured.tolist()) == list(range(N_ACTIONS))


@pytest.mark.parametrize("name", ["collins.jpg", "hopper.jpg"])
def test_actions_of_both_sides_are_measured_alike(model, name) -> None:
    image = read_image(PORTRAITS / name)
    grey = np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image)
    found = FaceTracker.load().locate(grey)
    flipped = np.ascontiguousarray(grey[:, ::-1])
    points = found.landmarks[MIRROR].copy()
    points[:, 0] = grey.shape[1] - 1.0 - points[:, 0]
    pose = found.pose * (1.0, 1.0, -1.0, -1.0, 1.0, 1.0)
    (eye,) = (part for part in model.actions if part.paired)
    one = measure_actions([eye], [eye.crops_at(grey, found.pose, found.landmarks)])
    other = measure_actions([eye], [eye.crops_at(flipped, pose, points)])
    np.testing.assert_allclose(one, other[ACTION_MIRROR], atol=0.05)
