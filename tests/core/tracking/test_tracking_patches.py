"""Patch experts: small networks on single patches."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from facemime.core.face.landmarks import MIRROR
from facemime.core.tracking.patch_experts import CONTRAST_FLOOR, HALF, PATCH, PatchExperts


def random_experts(seed: int, units: int = 5) -> PatchExperts:
    rng = np.random.default_rng(seed)
    hidden = rng.normal(0, 0.1, (66, PATCH * PATCH, units)).astype(np.float32)
    hidden -= hidden.mean(1, keepdims=True)
    bias, output = rng.normal(0, 0.1, (2, 66, units)).astype(np.float32)
    return PatchExperts(30.0, hidden, bias, output, rng.normal(0, 0.1, 66).astype(np.float32))


def random_picture(seed: int, size: int = 90) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 255, (size, size), np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def test_batched_responses_equal_those_of_single_patches() -> None:
    experts, pixels = random_experts(0), random_picture(1)
    centres = np.random.default_rng(2).integers(15, 75, (66, 2))
    likely, corner = experts.responses(pixels, centres, 3)
    for i in (0, 17, 40, 65):
        for row, column in ((0, 0), (3, 3), (6, 2)):
            x, y = corner[i] + (column, row)
            patch = pixels[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].ravel().astype(np.float64)
            patch = (patch - patch.mean()) / np.sqrt(patch.var() + CONTRAST_FLOOR**2)
            units = np.maximum(patch @ experts.hidden[i] + experts.hidden_bias[i], 0)
            expected = 1 / (1 + np.exp(-(units @ experts.output[i] + experts.output_bias[i])))
            assert likely[i, row, column] == pytest.approx(expected, abs=1e-3)


def test_windows_are_centred_and_stay_inside_the_image() -> None:
    experts, pixels = random_experts(0), random_picture(1)
    centres = np.full((66, 2), 40)
    centres[0] = (-500, 4000)
    likely, corner = experts.responses(pixels, centres, 4)
    assert likely.shape == (66, 9, 9)
    np.testing.assert_array_equal(corner[1] + 4, (40, 40))
    assert (corner >= HALF).all()
    assert (corner + 8 < 90 - HALF).all()


def test_mirrored_experts_respond_to_a_mirrored_image_as_the_originals_to_the_image() -> None:
    experts, pixels = random_experts(3), random_picture(4)
    centres = np.random.default_rng(5).integers(20, 70, (66, 2))
    flipped_centres = centres[MIRROR].copy()
    flipped_centres[:, 0] = 89 - flipped_centres[:, 0]
    likely, _ = experts.responses(pixels, centres, 3)
    mirrored = experts.mirrored(MIRROR)
    flipped, _ = mirrored.responses(np.ascontiguousarray(pixels[:, ::-1]), flipped_centres, 3)
    np.testing.assert_allclose(flipped, likely[MIRROR][:, :, ::-1], atol=1e-4)


def test_maps_are_centred_on_the_landmarks_in_the_face_frame() -> None:
    experts = random_experts(6)
    grey = np.random.default_rng(7).integers(0, 255, (200, 240), np.uint8)
    shape = np.random.default_rng(8).uniform(-0.5, 0.5, (66, 2))
    maps, highest = experts.respond(grey, np.array([60.0, 0.1, 0.2, 0.3, 120.0, 100.0]), shape)
    centre = maps.corner + maps.stride * (maps.likelihood.shape[1] - 1) / 2.0
    assert np.abs(centre - shape).max() <= 0.5 / experts.scale + 1e-6
    np.testing.assert_allclose(maps.likelihood.max((1, 2)), highest**2, rtol=1e-5)
    assert ((highest > 0) & (highest < 1)).all()


def test_experts_of_some_landmarks_respond_as_those_of_all() -> None:
    experts, grey = random_experts(9), random_picture(10, 200)
    shape = np.random.default_rng(11).uniform(-0.5, 0.5, (66, 2))
    some, pose = np.array([60, 3, 41]), np.array([60.0, 0.0, 0.1, -0.2, 100.0, 95.0])
    (every, highest), (few, theirs) = experts.respond(grey, pose, shape), experts.of(some).respond(grey, pose, shape)
    np.testing.assert_array_equal(few.landmarks, some)
    np.testing.assert_allclose(few.corner, every.corner[some], atol=1e-6)
    # Crops of other extents are warped alike, but for the rounding of the warp to 1/32 pixel.
    np.testing.assert_allclose(theirs, highest[some], atol=0.05)
    np.testing.assert_allclose(few.likelihood, every.likelihood[some], atol=0.05)
