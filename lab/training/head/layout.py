"""The texture layout: the base mesh's own unwrapping turned upright, with the middle of the face enlarged.

The unwrapping has no overlaps but gives the mouth few pixels. It is therefore stretched along each axis separately,
which creates no overlaps: half of the width goes to the front of the face. The neck is a strip below, followed by the
insides of mouth and lids, which are hardly seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .cut import CAVITY, FACE, NECK, SOCKET
from .surface import Surface

_NATIVE_ACROSS = (0.14, 0.4842, 0.83)
_NATIVE_DOWN = (0.638, 0.995)
_ACROSS = ([0.0, 0.05, 0.115, 0.2, 0.346], [0.0, 0.165, 0.335, 0.425, 0.5])
"""Native distance from the midline, and its new place: eyes end at 0.05, the cheek at 0.115, the ear at 0.2."""
_DOWN = ([0.638, 0.78, 0.82, 0.915, 0.945, 0.995], [0.995, 0.80, 0.70, 0.35, 0.25, 0.155])
"""Native height from the crown down: hairline at 0.78, brows at 0.82, mouth at 0.915, chin at 0.945."""

_NECK_STRIP = (0.075, 0.145)
_CAVITY_BOX = (0.36, 0.005, 0.64, 0.068)
_SOCKET_BOX = (0.72, 0.005, 0.80, 0.068)


def layout(surface: Surface, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Texture coordinates, (F, 4, 2), v up, of the corners of `surface` with `vertices` (V, 3); 0 at padding."""
    tokens, chart = surface.tokens, surface.token_chart
    native = surface.token_uv
    place = np.zeros((len(chart), 2))
    place[chart == FACE] = _face(native[chart == FACE])
    place[chart == CAVITY] = _into(native[chart == CAVITY][:, ::-1], _CAVITY_BOX, symmetric=True)
    place[chart == SOCKET] = _into(native[chart == SOCKET], _SOCKET_BOX, symmetric=False)
    uv = place[tokens]
    in_neck = (chart[tokens] == NECK) & (tokens >= 0)
    uv[in_neck] = _neck(
        np.abs(vertices[surface.faces[in_neck]] * [1, 0, 0]) + vertices[surface.faces[in_neck]] * [0, 1, 1]
    )
    uv[surface.mirrored, :, 0] = 1.0 - uv[surface.mirrored, :, 0]
    uv[surface.faces < 0] = 0.0
    return uv


def _face(native: NDArray[np.float64]) -> NDArray[np.float64]:
    """The native island lies on its side: its second axis runs across the face, its first down."""
    across = np.interp(np.abs(native[:, 1] - _NATIVE_ACROSS[1]), *_ACROSS)
    return np.c_[0.5 + across, np.interp(native[:, 0], *_DOWN)]


def _neck(points: NDArray[np.float64]) -> NDArray[np.float64]:
    around = np.arctan2(points[:, 0], -(points[:, 2] - 0.005)) / np.pi
    height = np.clip((0.145 - points[:, 1]) / 0.13, 0.0, 1.0)
    return np.c_[0.5 + 0.5 * around, _NECK_STRIP[0] + (_NECK_STRIP[1] - _NECK_STRIP[0]) * height]


def _into(native: NDArray[np.float64], box: tuple[float, ...], *, symmetric: bool) -> NDArray[np.float64]:
    """Fit coordinates into a box (left, bottom, right, top); the half of a symmetric island into its right half."""
    low, high = native.min(axis=0), native.max(axis=0)
    share = (native - low) / (high - low)
    left, bottom, right, top = box
    if symmetric:
        left = (left + right) / 2.0
    return np.c_[left + share[:, 0] * (right - left), bottom + share[:, 1] * (top - bottom)]
