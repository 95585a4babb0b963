"""Skin in place of what a texture shows around painted eyes: make-up, lashes and whites (method.md, section 7.4).

The lids of a FaceGen head or a scan are painted together with the eye. When they shut, the paint at their rims is
stretched over the whole eye: a rim of white or of mascara becomes a white or a black lid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..mesh.triangles import rasterise
from ..numeric.arrays import FloatArray
from .eyeballs import EyeOutline

_FIRST, _LAST = (-0.6, -0.8, -0.7), (1.6, 0.9, 0.7)
"""Surface around an eye that is looked at, in eye widths."""
_LARGEST = 192.0
"""Pixels per eye width in which skin is continued; larger images are covered by an enlarged layer."""
_ALWAYS = (0.05, 0.12)
"""Distances from the opening, in eye widths, up to which everything is painted over, and from which nothing is. These
and the following were chosen by looking at Jane, FaceGen's head; eyes drawn on three colours of skin confirm them."""
_ABOVE, _BELOW = (0.28, 0.45), (0.10, 0.22)
"""Such distances above and below for what is much darker or lighter than skin. A brow may be .5 above."""
_DARK, _LIGHT = (0.14, 0.34), (0.10, 0.25)
"""Differences of lightness, relative to the skin's, from which paint begins to be replaced, and is entirely."""
_BESIDE = (0.15, 0.4)
"""Distances below an eye between which the skin's lightness is measured."""
_BLUR = 0.02
"""Standard deviation, in eye widths, of the blur that separates paint from pores and noise."""
_RADIUS = 5.0
"""Radius in pixels from which skin is continued."""
_LASHES, _WATERLINE = (0.05, 0.20), (0.02, 0.60)
"""Width in eye widths, and lightness at the rim relative to skin, of the line of lashes and of the lower rim."""
_EDGE = (0.05, 0.45)
"""Width inside the opening, and lightness relative to skin, of the edge of the lids, which shows when they shut."""


@dataclass(frozen=True)
class PaintedEye:
    """The surface around an eye that is painted on a texture.

    Attributes
    ----------
    outline : EyeOutline
        The almond of its opening.
    triangles : (T, 3, 3) float64
        Corners of the triangles around it, in the frame of the outline's mesh.
    uv : (T, 3, 2) float64
        Their texture coordinates, v up.
    """

    outline: EyeOutline
    triangles: FloatArray
    uv: FloatArray


def skin_around_eyes(image: NDArray[np.uint8], eyes: Sequence[PaintedEye]) -> NDArray[np.uint8]:
    """Return a texture (H, W, 3) BGR with skin around its painted eyes, and lines of lashes along their openings."""
    out = image
    for eye in eyes:
        out = _without_paint(out, eye)
    return out


def _without_paint(image: NDArray[np.uint8], eye: PaintedEye) -> NDArray[np.uint8]:
    local = eye.outline.to_local(eye.triangles)
    middle = local.mean(axis=1)
    near = (middle >= _FIRST).all(axis=1) & (middle <= _LAST).all(axis=1)
    near &= ((eye.uv >= 0.0) & (eye.uv <= 1.0)).all(axis=(1, 2))
    height, width = image.shape[:2]
    pixels = eye.uv[near] * (width, -height) + (-0.5, height - 0.5)
    local = local[near, :, :2]
    density = np.sqrt(np.abs(_areas(pixels).sum()) / max(float(np.abs(_areas(local)).sum()), 1e-12))
    if not len(local) or density < 1.0:
        return image
    first = np.maximum(np.floor(pixels.min(axis=(0, 1))).astype(int), 0)
    last = np.minimum(np.ceil(pixels.max(axis=(0, 1))).astype(int) + 1, (width, height))
    box = np.s_[first[1] : last[1], first[0] : last[0]]
    crop = image[box]
    factor = min(1.0, _LARGEST / float(density))
    size = tuple(np.maximum(np.round((last - first) * factor), 1).astype(int).tolist())
    small = np.asarray(cv2.resize(crop, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    scale = np.array(size) / (last - first)
    places = _places((pixels - first + 0.5) * scale - 0.5, local, (small.shape[0], small.shape[1]))
    skin, share = (
        cv2.resize(layer, crop.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        for layer in _layers(small, places, eye.outline, float(density) * factor)
    )
    out = image.copy()
    out[box] = np.round(crop + share[..., None] * (skin - crop)).astype(np.uint8)
    return out


def _areas(corners: FloatArray) -> FloatArray:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _places(pixels: FloatArray, local: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return the point of the eye's frame (H, W, 2) that each pixel shows; NaN where it shows none."""
    corners, side = np.arange(3 * len(pixels)).reshape(-1, 3), max(shape)
    seen = rasterise(pixels.reshape(-1, 2), np.zeros(corners.size), corners, side)
    out = np.full((side * side, 2), np.nan)
    out[seen.pixel] = (seen.barycentric[..., None] * local[seen.triangle]).sum(axis=1)
    return out.reshape(side, side, 2)[: shape[0], : shape[1]]


def _layers(
    image: NDArray[np.uint8], places: FloatArray, outline: EyeOutline, density: float
) -> tuple[FloatArray, FloatArray]:
    """Return skin and lashes (H, W, 3), and how much they cover (H, W), for a small image (H, W, 3).

    Its pixels show `places` (H, W, 2), with `density` pixels per eye width.
    """
    x, y = places[..., 0], places[..., 1]
    known = np.isfinite(x)
    x, y = np.where(known, x, 9.0), np.where(known, y, 9.0)
    within = np.clip(x, 0.0, 1.0)
    upper, lower = outline.lids(within)
    away = np.where(x == within, np.maximum(y - upper, lower - y), np.hypot(x - within, y))
    above = y > (upper + lower) / 2.0
    lightness = _blurred(image.astype(np.float64).mean(axis=2), density)
    skin = known & ~above & (away > _BESIDE[0]) & (away < _BESIDE[1]) & (x == within)
    if not skin.any():
        return image.astype(np.float64), np.zeros(x.shape)
    usual = max(float(np.median(lightness[skin])), 1.0)
    # 1. What is paint: everything at the rims, and farther away what is much darker or lighter than skin.
    unlike = np.maximum(_step(1.0 - lightness / usual, *_DARK), _step(lightness / usual - 1.0, *_LIGHT))
    unlike = np.asarray(cv2.dilate(unlike, np.ones((1 + 2 * round(_BLUR * density),) * 2)), dtype=np.float64)
    reach = np.where(above, 1.0 - _step(away, *_ABOVE), 1.0 - _step(away, *_BELOW))
    share = np.maximum(1.0 - _step(away, *_ALWAYS), unlike * reach) * known
    share = _blurred(share, density)
    # 2. The skin around is continued over it, and the line of lashes drawn on that.
    mask = cv2.dilate((share > 0.05).astype(np.uint8), np.ones((3, 3), np.uint8))
    filled = _blurred(cv2.inpaint(image, mask, _RADIUS, cv2.INPAINT_TELEA).astype(np.float64), density)
    line, dark = np.where(above, _LASHES[0], _WATERLINE[0]), np.where(above, _LASHES[1], _WATERLINE[1])
    shade = 1.0 - (1.0 - dark) * np.clip(1.0 - away / line, 0.0, 1.0)
    inside = away < 0.0
    share[inside] = 1.0 - _step(-away[inside], 0.6 * _EDGE[0], _EDGE[0])
    shade[inside] = _EDGE[1]
    return filled * shade[..., None], share


def _blurred(layer: FloatArray, density: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), max(_BLUR * density, 0.5)), dtype=np.float64)


def _step(values: FloatArray, low: float, high: float) -> FloatArray:
    """Rise from 0 to 1 between two values, smoothly."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
