"""Short-cropped hair, brows and stubble: where they grow, and their strokes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .canvas import FrontView, Image, fade, noise
from .complexion import Complexion


def inside_hairline(place: NDArray[np.floating], hairline: NDArray[np.float64]) -> NDArray[np.floating]:
    """Height of positions (..., 3) above a hairline in metres; the ears count as inside where they are high."""
    around = np.degrees(np.arctan2(np.abs(place[..., 0]), -place[..., 2]))
    return np.asarray(np.interp(around, *hairline.T) - place[..., 1])


def crop_lift(vertices: NDArray[np.float64], ear: NDArray[np.float64], look: Complexion) -> NDArray[np.float64]:
    """Height in metres by which hair lifts the scalp, (V,); `ear` (V,) is 1 on the ears, where none grows."""
    return np.asarray(look.hair_lift * fade(inside_hairline(vertices, look.hairline), 0.000, 0.014) * (1.0 - ear))


def crop(place: Image, ear: Image, look: Complexion) -> tuple[Image, Image]:
    """Coverage (S, S) by hair, 0 to 1, and its shade, about 1."""
    height = inside_hairline(place, look.hairline).astype(np.float32)
    ragged = 0.0022 * noise(place, 0.0050, 11) + 0.0012 * noise(place, 0.0018, 12)
    edge = fade(height + ragged, *look.hair_edge)
    strands = noise(place * np.float32(look.comb), 0.00055, 13)
    thin = np.clip(edge + 0.9 * edge * (1.0 - edge) * strands * 1.6, 0.0, 1.0)
    shade = 1.0 + 0.22 * strands + 0.10 * noise(place, 0.006, 14)
    return thin * fade(ear, 0.65, 0.25), shade


_LEVEL = (0.0, 0.5, 1.0), (0.0022, 0.0, -0.0016)
"""Shares of the length of a brow from its inner end, and metres by which it lies below the landmarks, which slope down
outwards on hm08 as in a worried face."""


def brow_level(t: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Metres by which a brow lies below its landmarks at a share `t` of its length from the inner end."""
    return np.asarray(np.interp(t, *_LEVEL))


def brow_strokes(view: FrontView, brow: NDArray[np.float64], width: float, rng: np.random.Generator) -> None:
    """Draw both brows.

    `brow` (5, 2) are the left brow's landmarks from its inner end outwards, upper-mid of the hair; `width` is relative
    to the man's.
    """
    knots = np.linspace(0.0, 1.0, len(brow))
    for _ in range(470):
        t = rng.beta(1.15, 1.15)
        half = width * np.interp(t, [0.0, 0.12, 0.55, 1.0], [0.0016, 0.0031, 0.0028, 0.0006])
        across = np.clip(rng.normal(0.0, 0.48), -1.0, 1.0)
        root = np.array([np.interp(t, knots, brow[:, i]) for i in range(2)])
        root += [0.0, 0.0010 + brow_level(t) + across * half]
        steep = np.interp(t, [0.0, 0.25, 0.6, 1.0], [68.0, 38.0, 12.0, -22.0]) + rng.normal(0.0, 9.0) + across * 20.0
        angle = np.radians(steep)
        length = np.interp(t, [0.0, 0.3, 0.8, 1.0], [0.0052, 0.0072, 0.0062, 0.0036]) * rng.uniform(0.75, 1.1)
        bend = np.radians(rng.normal(-16.0, 6.0))
        points = [root]
        for step in range(4):
            direction = angle + bend * step / 3.0
            points.append(points[-1] + length / 4.0 * np.array([np.cos(direction), -np.sin(direction)]))
        hair = np.array(points)
        strength = rng.uniform(0.30, 0.66) * np.interp(t, [0.0, 0.18], [0.55, 1.0])
        view.stroke(hair, 0.00028, strength)
        view.stroke(hair * [-1.0, 1.0], 0.00028, strength)


def beard_shade(place: Image, points: NDArray[np.float64]) -> Image:
    """Visibility of a shaved beard, 0 to 1; `points` (66, 3) are the landmarks."""
    corner, chin, nose, cheek = points[54], points[8], points[33], points[12]
    x, y, z = np.abs(place[..., 0]), place[..., 1], place[..., 2]
    lower = fade(y, nose[1] - 0.001, nose[1] + 0.010)
    slant = y + 0.55 * (x - corner[0])
    cheeks = 1.0 - fade(x, corner[0] + 0.004, corner[0] + 0.02) * fade(slant, cheek[1] + 0.012, cheek[1] - 0.012)
    throat = fade(y, chin[1] + 0.030, chin[1] + 0.008)
    front = fade(z, -0.018, -0.040)
    return np.asarray(lower * np.clip(cheeks, 0.0, 1.0) * throat * front, np.float32)
