"""Patch experts and the reference frame they look at."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from facemime.core.landmarks import MIRROR
from facemime.core.tracking.patch_experts import CONTRAST_FLOOR, HALF, PATCH, PatchExperts
from facemime.core.tracking.reference import frame_size, warp_to_reference


def random_experts(seed: int, units: int = 5) -> PatchExperts:
    rng = np.random.default_rng(seed)
    hidden = rng.normal(0, 0.1, (66, PATCH * PATCH, units)).astype(np.float32)
    hidden -= hidden.mean(1, keepdims=True)
    bias, output = rng.normal(0, 0.1, (2, 66, units)).astype(np.float32)
    return PatchExperts(30.0, hidden, bias, output, rng.normal(0, 0.1, 66).astype(np.float32))


def random_picture(seed: int, size: int = 90) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(0, 255, (size, size)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def test_the_batched_responses_are_those_of_each_patch_by_itself() -> None:
    experts, pixels = random_experts(0), random_picture(1)
    centres = np.random.default_rng(2).integers(15, 75, (66, 2))
    maps = experts.response_maps(pixels, centres, 3)
    for i in (0, 17, 40, 65):
        for row, column in ((0, 0), (3, 3), (6, 2)):
            x, y = maps.corner[i] + (column, row)
            patch = pixels[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].ravel().astype(np.float64)
            patch = (patch - patch.mean()) / np.sqrt(patch.var() + CONTRAST_FLOOR**2)
            units = np.maximum(patch @ experts.hidden[i] + experts.hidden_bias[i], 0)
            expected = 1 / (1 + np.exp(-(units @ experts.output[i] + experts.output_bias[i])))
            assert maps.probability[i, row, column] == pytest.approx(expected, abs=1e-3)


def test_windows_are_centred_and_stay_inside_the_picture() -> None:
    experts, pixels = random_experts(0), random_picture(1)
    centres = np.full((66, 2), 40)
    centres[0] = (-500, 4000)
    maps = experts.response_maps(pixels, centres, 4)
    assert maps.probability.shape == (66, 9, 9)
    np.testing.assert_array_equal(maps.corner[1] + 4, (40, 40))
    assert (maps.corner >= HALF).all()
    assert (maps.corner + 8 < 90 - HALF).all()


def test_mirrored_experts_see_a_mirrored_picture_as_the_originals_see_the_picture() -> None:
    experts, pixels = random_experts(3), random_picture(4)
    centres = np.random.default_rng(5).integers(20, 70, (66, 2))
    flipped_centres = centres[MIRROR].copy()
    flipped_centres[:, 0] = 89 - flipped_centres[:, 0]
    maps = experts.response_maps(pixels, centres, 3)
    flipped = experts.mirrored(MIRROR).response_maps(np.ascontiguousarray(pixels[:, ::-1]), flipped_centres, 3)
    np.testing.assert_allclose(flipped.probability, maps.probability[MIRROR][:, :, ::-1], atol=1e-4)


@pytest.mark.parametrize("scale", [20.0, 60.0, 250.0])
def test_poses_go_to_the_reference_frame_and_back(scale: float) -> None:
    grey = np.zeros((300, 400), np.uint8)
    pose = np.array([scale, 0.1, -0.2, 0.3, 210.0, 130.0])
    frame = warp_to_reference(grey, pose, 40.0)
    local = frame.pose_to_reference(pose)
    assert local[0] == pytest.approx(40.0)
    assert local[3] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(local[4:6], (frame_size(40.0) - 1) / 2)
    np.testing.assert_allclose(frame.pose_to_image(local), pose, atol=1e-9)


@pytest.mark.parametrize("scale", [30.0, 90.0, 190.0])
def test_a_spot_appears_where_the_similarity_says(scale: float) -> None:
    grey = np.zeros((480, 640), np.uint8)
    spot = np.array([330.0, 220.0])
    cv2.circle(grey, (330, 220), max(int(scale / 12), 2), 255, -1)
    pose = np.array([scale, 0.0, 0.0, 0.4, 300.0, 240.0])
    frame = warp_to_reference(grey, pose, 40.0)
    y, x = np.mgrid[0 : frame.pixels.shape[0], 0 : frame.pixels.shape[1]]
    mass = frame.pixels / frame.pixels.sum()
    np.testing.assert_allclose(((mass * x).sum(), (mass * y).sum()), frame.linear @ spot + frame.offset, atol=0.25)


def test_a_face_beyond_the_image_still_gives_a_frame() -> None:
    grey = np.full((60, 80), 90, np.uint8)
    for place in ((-500.0, 20.0), (1e6, 1e6), (40.0, 30.0)):
        frame = warp_to_reference(grey, np.array([50.0, 0, 0, 0.1, *place]), 40.0)
        assert frame.pixels.shape == (frame_size(40.0),) * 2
        assert np.isfinite(frame.pixels).all()
