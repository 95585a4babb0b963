"""Skin in place of what a texture shows around painted eyes."""

import numpy as np
import pytest

from facemime.core.heads.eyeballs import EyeOutline
from facemime.core.heads.painted_eyes import PaintedEye, skin_around_eyes

OUTLINE = EyeOutline(np.zeros(3), np.eye(3), 30.0, np.array([0.76, -0.48]), 0.0)
LOW, HIGH = np.array([-0.8, -0.9]), np.array([1.8, 1.0])
"""The surface that the texture shows, in eye widths."""
SKINS = [(70, 95, 140), (170, 190, 225), (30, 42, 70)]


def drawn(skin, density, *, mirrored=False, seed=0):
    """A texture of skin (H, W, 3) with a painted eye that is larger than its opening and made up, the skin alone, and
    the point of the eye's frame (H, W, 2) that each pixel shows.
    """
    width, height = np.round((HIGH - LOW) * density).astype(int)
    x = LOW[0] + (np.arange(width) + 0.5) / density
    y = HIGH[1] - (np.arange(height) + 0.5) / density
    places = np.stack(np.meshgrid(x, y), axis=-1)
    noise = np.random.default_rng(seed).normal(0.0, 4.0, (height, width, 1))
    bare = np.clip(np.array(skin) + noise, 0, 255)
    away = -OUTLINE.depth_within(places)
    over = places[..., 1] > 0.0
    image = bare.copy()
    image[(away < 0.2) & over & (np.abs(places[..., 0] - 0.5) < 0.7)] = (20, 18, 25)  # make-up
    image[(away < 0.05) & (np.abs(places[..., 0] - 0.5) < 0.55)] = (235, 235, 235)  # the white, beyond the cut
    image[np.linalg.norm(places - (0.5, 0.05), axis=-1) < 0.15] = (40, 30, 20)
    images = [image.astype(np.uint8), bare.astype(np.uint8), places]
    return [np.ascontiguousarray(one[:, ::-1]) for one in images] if mirrored else images


def eye(*, mirrored=False):
    corners = np.array([[LOW[0], LOW[1], 0.0], [HIGH[0], LOW[1], 0.0], [HIGH[0], HIGH[1], 0.0], [LOW[0], HIGH[1], 0.0]])
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uv[:, 0] = 1.0 - uv[:, 0] if mirrored else uv[:, 0]
    rows = np.array([[0, 1, 2], [0, 2, 3]])
    return PaintedEye(OUTLINE, OUTLINE.from_local(corners)[rows], uv[rows])


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize(("density", "mirrored"), [(60.0, False), (150.0, True), (500.0, False)])
def test_whites_and_make_up_around_an_eye_become_skin(skin, density, mirrored):
    image, bare, places = drawn(skin, density, mirrored=mirrored)
    out = skin_around_eyes(image, [eye(mirrored=mirrored)]).astype(np.float64)
    away = -OUTLINE.depth_within(places)
    lid = (away > 0.08) & (away < 0.3) & (np.abs(places[..., 0] - 0.5) < 0.4)
    before, after = (np.abs(one[lid].mean(axis=1) - bare[lid].mean(axis=1)) for one in (image, out))
    assert before.mean() > 0.1 * np.mean(skin)
    assert np.percentile(after, 99.0) < 12.0, "three times the noise of the skin"
    rim = (away > 0.0) & (away < 0.05) & (np.abs(places[..., 0] - 0.5) < 0.4)
    assert (out[rim].mean(axis=1) < np.mean(skin) + 12.0).all(), "no white is left at the rims"


def test_nothing_changes_far_from_an_eye_nor_in_its_middle():
    image, _, places = drawn(SKINS[0], 150.0)
    out = skin_around_eyes(image, [eye()])
    away = -OUTLINE.depth_within(places)
    far = (np.abs(places[..., 0] - 0.5) < 0.5) & ((away > 0.5) | (away < -0.08))
    np.testing.assert_array_equal(out[far], image[far])


def test_a_texture_that_does_not_show_the_eye_stays_as_it_is():
    image, _, _ = drawn(SKINS[0], 60.0)
    elsewhere = PaintedEye(OUTLINE, eye().triangles + 500.0, eye().uv)
    tiled = PaintedEye(OUTLINE, eye().triangles, eye().uv + 3.0)
    assert skin_around_eyes(image, [elsewhere, tiled]) is image
