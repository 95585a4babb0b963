"""Lashes and the hairs of the brows as geometry, which rides on the skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from . import anatomy
from .complexion import Complexion
from .hair import brow_level
from .organs import BROW_COLUMNS, LASH_COLUMNS
from .ribbons import Points, Shape, joined, ribbons, sideways, unit

_SEED = 31
_UPPER, _LOWER, _BROW = 23, 11, 84
"""Number of lashes of each lid, and of hairs of each brow."""
_LENGTH = 0.0070
"""Metres; of the longest lash."""
_BESIDE, _BEHIND = 0.005, 0.005
"""A vertex is hidden that has one this near in the front view that is so much nearer, in metres."""
_MIRROR = np.array([-1.0, 1.0, 1.0])


def lashes_and_brows(
    points: Points, vertices: Points, landmarks: NDArray[np.int64], eye: Points, look: Complexion
) -> Shape:
    """Lashes and brows of both sides.

    `points` (N, 3) are the vertices of hm08, `vertices` (V, 3) those of the skin with `landmarks` (66,), and `eye` (3,)
    is the middle of the left eyeball.
    """
    rng = np.random.default_rng(_SEED)
    left = joined(
        _lashes(points[[*anatomy.UPPER_LID_EDGE]], eye, -1.0, _UPPER, look.lashes, rng),
        _lashes(points[[*anatomy.LOWER_LID_EDGE]], eye, 1.0, _LOWER, look.lashes, rng),
        _brow(vertices, landmarks, look.brow, rng),
    )
    turned = left.faces.copy()
    quad = turned[:, 3] >= 0
    turned[quad] = turned[quad][:, ::-1]
    turned[~quad, :3] = turned[~quad, 2::-1]
    uv = left.uv.copy()
    uv[quad] = uv[quad][:, ::-1]
    uv[~quad, :3] = uv[~quad, 2::-1]
    return joined(left, Shape(left.vertices * _MIRROR, turned, uv))


def _lashes(rim: Points, eye: Points, down: float, count: int, strength: float, rng: np.random.Generator) -> Shape:
    """Lashes along `rim` (n, 3), from the inner corner of the left eye outwards, which curl up (`down` -1) or down."""
    upper = down < 0
    t = np.linspace(0.10 if upper else 0.30, 0.975 if upper else 0.95, count) + rng.normal(0.0, 0.004, count)
    length = _LENGTH * (1.0 if upper else 0.42) * (0.82 + 0.18 * strength) * rng.uniform(0.85, 1.1, count)
    length *= np.interp(t, [0.0, 0.35, 0.75, 1.0], [0.45, 0.85, 1.0, 0.75])
    fan = np.interp(t, [0.0, 0.4, 1.0], [-0.30, 0.10, 0.75]) + rng.normal(0.0, 0.06, count)
    reach = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rim, axis=0), axis=1))])
    roots = np.column_stack([np.interp(t, reach / reach[-1], rim[:, i]) for i in range(3)])
    ahead = np.column_stack([np.interp(t + 0.05, reach / reach[-1], rim[:, i]) for i in range(3)])
    aside = unit(ahead - np.column_stack([np.interp(t - 0.05, reach / reach[-1], rim[:, i]) for i in range(3)]))
    outwards = unit(roots - eye)
    s = np.linspace(0.0, 1.0, 4)[:, None]
    droop, curl = (0.10, 0.78) if upper else (0.05, 0.42)
    lift = down * (curl * s**2 - (droop * s if upper else -droop * s))
    course = 0.85 * s * outwards[:, None] + fan[:, None, None] * 0.62 * s * np.array([1.0, 0.0, 0.15])
    course = course + lift * np.array([0.0, 1.0, 0.0])
    paths = roots[:, None] - 0.0002 * outwards[:, None] + length[:, None, None] * course
    half = (0.00021 if upper else 0.00014) * (0.75 + 0.25 * strength) * np.array([1.0, 0.85, 0.55, 0.0])
    across = half[:, None] * aside[:, None]
    return ribbons(paths, across, np.tile(LASH_COLUMNS, (count, 1)))


def _brow(vertices: Points, landmarks: NDArray[np.int64], width: float, rng: np.random.Generator) -> Shape:
    """Hairs of the left brow; they lie as the painted ones do, a little off the skin."""
    brow = vertices[landmarks[22:27], :2]
    surface = _front(vertices)
    knots = np.linspace(0.0, 1.0, len(brow))
    t = np.clip(rng.beta(1.15, 1.15, _BROW), 0.07, 0.97)
    across = np.clip(rng.normal(0.0, 0.48, _BROW), -1.0, 1.0)
    root = np.column_stack([np.interp(t, knots, brow[:, i]) for i in range(2)])
    root[:, 1] += (
        0.0010 + brow_level(t) + across * width * np.interp(t, [0.0, 0.12, 0.55, 1.0], [0.0016, 0.0031, 0.0028, 0.0006])
    )
    steep = np.interp(t, [0.0, 0.25, 0.6, 1.0], [68.0, 38.0, 12.0, -22.0]) + rng.normal(0.0, 9.0, _BROW) + across * 20.0
    length = np.interp(t, [0.0, 0.3, 0.8, 1.0], [0.0052, 0.0072, 0.0062, 0.0036]) * rng.uniform(0.75, 1.1, _BROW)
    bend = np.radians(rng.normal(-16.0, 6.0, _BROW))
    s = np.linspace(0.0, 1.0, 4)
    angle = np.radians(steep)[:, None] + bend[:, None] * s
    steps = length[:, None, None] / 3.0 * np.stack([np.cos(angle), -np.sin(angle)], axis=-1)[:, :-1]
    flat = root[:, None] + np.concatenate([np.zeros((_BROW, 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    depth = surface(flat.reshape(-1, 2)).reshape(flat.shape[:2])
    paths = np.concatenate([flat, depth[..., None]], axis=-1)
    off = np.array([-0.0001, 0.0007, 0.0011, 0.0010]) * rng.uniform(0.7, 1.2, (_BROW, 1))
    paths[..., 2] -= off
    normals = np.broadcast_to(np.array([0.25, 0.0, -1.0]), paths.shape)
    half = 0.00026 * np.array([0.8, 1.0, 0.75, 0.0]) * np.ones((_BROW, 1))
    return ribbons(paths, sideways(paths, normals, half, np.zeros((_BROW, 1))), np.tile(BROW_COLUMNS, (_BROW, 1)))


def _front(vertices: Points) -> LinearNDInterpolator:
    """Depth of the forehead and the brows by x and y, without the sockets behind them."""
    near = vertices[(vertices[:, 2] < -0.035) & (vertices[:, 1] < 0.004) & (vertices[:, 1] > -0.06)]
    beside = cKDTree(near[:, :2]).query_ball_point(near[:, :2], _BESIDE)
    foremost = np.array([near[rows, 2].min() for rows in beside])
    seen = near[near[:, 2] < foremost + _BEHIND]
    return LinearNDInterpolator(seen[:, :2], seen[:, 2])
