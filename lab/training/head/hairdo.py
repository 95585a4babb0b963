"""Hair as geometry: locks that are combed over the scalp, the man's short with a parting, the woman's into a knot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from .canvas import fade
from .complexion import Complexion
from .hair import inside_hairline
from .organs import HAIR_COLUMNS
from .ribbons import Points, Shape, joined, ribbons, sideways, unit

_MIDDLE = np.array([0.0, -0.015, 0.020])
"""Place within the skull, head frame, from which the scalp is described by its distance."""
_LOCK = 0.11
"""Width of a lock in the texture."""
_SEED = 23


@dataclass(frozen=True)
class Scalp:
    """The scalp as a distance from the middle of the skull in each direction."""

    radius: RBFInterpolator

    def place(self, directions: Points, height: NDArray[np.float64]) -> Points:
        """Places (..., 3) in unit `directions`, `height` (...) metres above the scalp."""
        radius = self.radius(directions.reshape(-1, 3)).reshape(directions.shape[:-1])
        return np.asarray(_MIDDLE + (radius + height)[..., None] * directions)

    def normals(self, directions: Points) -> Points:
        """Unit normals (..., 3) of the scalp in `directions`."""
        first = unit(np.cross(directions, [0.31, 0.17, 0.94]))
        second = np.cross(directions, first)
        step, zero = 0.03, np.zeros(directions.shape[:-1])
        here = self.place(directions, zero)
        one = self.place(unit(directions + step * first), zero) - here
        two = self.place(unit(directions + step * second), zero) - here
        normal = unit(np.cross(one, two))
        return np.asarray(normal * np.sign((normal * directions).sum(axis=-1, keepdims=True)))


@dataclass(frozen=True)
class Haircut:
    """How hair is combed, and the distance between its roots in metres."""

    comb: Callable[[Scalp, Points, Complexion], Shape]
    spacing: float


def cut_hair(
    cut: Haircut, vertices: Points, faces: NDArray[np.int64], ear: NDArray[np.float64], look: Complexion
) -> Shape:
    """The hair of a head with skin `vertices` (V, 3) and `faces` (F, 4), whose share of ear is `ear` (V,)."""
    scalp = _scalp_of(vertices, ear, look)
    return cut.comb(scalp, _roots_on(vertices, faces, ear, look, cut.spacing), look)


def _scalp_of(vertices: Points, ear: NDArray[np.float64], look: Complexion) -> Scalp:
    """The scalp of a head with skin `vertices` (V, 3), without its ears, whose share is `ear` (V,)."""
    near = (inside_hairline(vertices, look.hairline) > -0.035) & (ear < 0.02) & (vertices[:, 1] < 0.08)
    arms = vertices[near] - _MIDDLE
    radius = np.linalg.norm(arms, axis=1)
    return Scalp(RBFInterpolator(arms / radius[:, None], radius, smoothing=1e-7, kernel="cubic"))


def _roots_on(
    vertices: Points, faces: NDArray[np.int64], ear: NDArray[np.float64], look: Complexion, spacing: float
) -> Points:
    """Directions (N, 3) from the middle of the skull of places where hair grows, about `spacing` metres apart."""
    rng = np.random.default_rng(_SEED)
    triangles = np.vstack([faces[:, :3], faces[faces[:, 3] >= 0][:, [0, 2, 3]]])
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    grows = (inside_hairline(corners.mean(axis=1), look.hairline) > -0.004) & (ear[triangles].max(axis=1) < 0.05)
    outside = ((corners.mean(axis=1) - _MIDDLE) ** 2).sum(axis=1) > 0.06**2
    chosen = rng.choice(len(triangles), 40_000, p=(area * grows * outside) / (area * grows * outside).sum())
    share = rng.dirichlet((1.0, 1.0, 1.0), len(chosen))
    points = np.einsum("nk,nkc->nc", share, corners[chosen])
    points = points[inside_hairline(points, look.hairline) > 0.0]
    return unit(_thinned(points, spacing) - _MIDDLE)


def _thinned(points: Points, spacing: float) -> Points:
    """Drop points that are closer to an earlier one than `spacing`."""
    kept = np.ones(len(points), dtype=bool)
    for row, others in enumerate(cKDTree(points).query_ball_point(points, spacing)):
        if kept[row]:
            kept[[other for other in others if other > row]] = False
    return points[kept]


def crop_locks(scalp: Scalp, roots: Points, look: Complexion) -> Shape:
    """Short hair with a side parting, combed from the crown down and across the forehead."""
    rng = np.random.default_rng(_SEED)
    steps = 5
    start = scalp.place(roots, np.zeros(len(roots)))
    top = fade(start[:, 1], -0.045, -0.085)
    front = top * fade(start[:, 2], 0.055, -0.005)
    length = (0.010 + 0.022 * top + 0.006 * front) * rng.uniform(0.8, 1.25, len(roots))
    rise = (0.0019 + 0.0056 * top + 0.0045 * front) * rng.uniform(0.5, 1.15, len(roots))
    side = np.where(start[:, 0] > -0.030, 1.0, -1.0)
    direction, path = roots, [roots]
    for _ in range(steps - 1):
        comb = _combed(direction, side, front, 1.0 - top)
        radius = np.linalg.norm(scalp.place(direction, np.zeros(len(roots))) - _MIDDLE, axis=1)
        direction = unit(direction + (length / radius / (steps - 1))[:, None] * comb)
        path.append(direction)
    directions = np.stack(path, axis=1)
    s = np.linspace(0.0, 1.0, steps)
    height = 0.0008 + rise[:, None] * np.sin(s * 0.75 * np.pi) ** 0.8
    paths = scalp.place(directions, height)
    edge = fade(inside_hairline(start, look.hairline), 0.016, 0.002)
    half = 0.0021 * np.array([0.8, 1.0, 0.9, 0.6, 0.0]) * rng.uniform(0.7, 1.2, (len(roots), 1))
    half *= (1.0 - 0.55 * edge * (1.0 - 0.6 * front))[:, None]
    twist = rng.normal(0.0, 1.0, (len(roots), 1)) * (0.10 + 0.14 * top)[:, None]
    return ribbons(paths, sideways(paths, scalp.normals(directions), half, twist), _columns(rng, len(roots)))


def _combed(
    direction: Points, side: NDArray[np.float64], front: NDArray[np.float64], low: NDArray[np.float64]
) -> Points:
    """Unit tangents (N, 3) along which short hair lies."""
    crown = unit(np.array([0.010, -0.075, 0.090]) - _MIDDLE)
    flow = unit(direction - crown)
    across = np.column_stack([1.1 * side, np.full(len(side), 0.25), np.full(len(side), -0.45)])
    down = np.array([0.0, 1.0, 0.25])
    wish = (1.0 - front)[:, None] * flow + front[:, None] * across + 0.9 * low[:, None] * down
    return unit(wish - (wish * direction).sum(axis=1, keepdims=True) * direction)


def knot_locks(scalp: Scalp, roots: Points, look: Complexion) -> Shape:
    """Long hair that is combed back into a knot."""
    rng = np.random.default_rng(_SEED)
    steps = 8
    back = unit(np.array([0.0, -0.030, 0.118]) - _MIDDLE)
    angle = np.arccos(np.clip(roots @ back, -1.0, 1.0))
    far = angle > 0.45
    roots, angle = roots[far], angle[far]
    s = np.linspace(0.0, 1.0, steps)
    reached = angle[:, None] * (1.0 - s) + 0.22 * s
    aside = unit(roots - (roots @ back)[:, None] * back)
    directions = np.cos(reached)[..., None] * back + np.sin(reached)[..., None] * aside[:, None]
    volume = (0.0012 + rng.uniform(0.0, 0.0022, (len(roots), 1))) * np.sin(np.pi * np.minimum(1.1 * s, 1.0))
    paths = scalp.place(directions, 0.0006 + volume)
    narrow = 0.35 + 0.65 * np.sin(reached) / np.sin(np.minimum(angle, np.pi / 2))[:, None]
    half = 0.0030 * np.array([0.06, 0.45, 0.85, *[1.0] * (steps - 4), 0.0]) * np.clip(narrow, 0.3, 1.0)
    half = half * rng.uniform(0.7, 1.2, (len(roots), 1))
    twist = rng.normal(0.0, 0.07, (len(roots), 1))
    combed = ribbons(paths, sideways(paths, scalp.normals(directions), half, twist), _columns(rng, len(roots)))
    return joined(combed, _knot(scalp.place(back, np.array(0.012)), back, rng))


def _knot(centre: Points, axis: Points, rng: np.random.Generator) -> Shape:
    """A coil of hair around `axis` (3,)."""
    count, steps, large, small = 130, 9, 0.0155, 0.0150
    first = unit(np.cross(axis, [0.0, 0.0, 1.0]))
    second = np.cross(axis, first)
    begin, around = rng.uniform(0.0, 2 * np.pi, (2, count, 1))
    turn = begin + np.linspace(0.0, 2.2, steps)
    tube = around + np.linspace(0.0, 1.1, steps)
    outwards = np.cos(turn)[..., None] * first + np.sin(turn)[..., None] * second
    normals = np.cos(tube)[..., None] * outwards + np.sin(tube)[..., None] * axis
    thick = small * rng.uniform(0.94, 1.06, (count, 1, 1))
    paths = centre + large * outwards + thick * normals
    half = 0.0030 * np.array([0.4, *[1.0] * (steps - 2), 0.0]) * np.ones((count, 1))
    return ribbons(paths, sideways(paths, normals, half, rng.normal(0.0, 0.2, (count, 1))), _columns(rng, count))


def _columns(rng: np.random.Generator, count: int) -> Points:
    left = rng.uniform(HAIR_COLUMNS[0], HAIR_COLUMNS[1] - _LOCK, count)
    return np.column_stack([left, left + _LOCK])
