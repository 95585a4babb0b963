"""Cost of preparing a deformer and of a frame, for random points and increasingly fine meshes of the built-in head."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from facemime.core.drive.head_deformer import head_deformer
from facemime.core.drive.rbf import RBFDeformer
from facemime.core.heads.rig import HeadRig, built_in_head
from lab.bench.report import Table

COLUMNS = (
    "mesh",
    "vertices",
    "points",
    "preparation, ms",
    "frame, µs",
    "MB",
    "relative to a copy",
    "relative to a dense product",
)
_SIZES = ((1_781, 30), (26_000, 60), (100_000, 60))
_HALVINGS = (0, 2, 3)
_BATCHES, _FRAMES, _PREPARATIONS = 20, 50, 10
"""Number of batches, of frames in a batch, and of preparations. The fastest counts, as in timeit: other load can only
add time."""


def speed_table() -> Table:
    """Measure random points with the paper's kernel, and the built-in head with halved edges with the informed kernel.

    The last columns compare a frame in the same run with a plain copy of as many bytes as its matrices take, as memory
    may be the limit, and with the product by one dense matrix of all vertices and points.
    """
    rows = [_row("random", lambda size=size: _random(*size)) for size in _SIZES]
    rig, done = built_in_head(), 0
    for halvings in _HALVINGS:
        while done < halvings:
            rig, done = finer(rig), done + 1
        rows.append(_row("built-in head", lambda rig=rig: head_deformer(rig)))
    return Table("Cost of the deformer on one core", COLUMNS, rows)


def _row(mesh: str, build: Callable[[], RBFDeformer]) -> tuple[object, ...]:
    deformer, prepare = build(), _fastest(build, _PREPARATIONS, 1)
    points = deformer.n_control_points
    moved = np.random.default_rng(0).normal(0.0, 0.01, (points, 3)).astype(np.float32)
    out, source = np.empty_like(deformer.rest), np.ones(deformer.nbytes, dtype=np.uint8)
    target = np.ones_like(source)
    dense = np.ones((len(out), points), dtype=np.float32)
    frame, copy = _fastest(lambda: deformer.deform(moved, out)), _fastest(lambda: np.copyto(target, source))
    product = _fastest(lambda: np.matmul(dense, moved, out=out))
    return mesh, len(out), points, 1e3 * prepare, 1e6 * frame, deformer.nbytes / 1e6, frame / copy, frame / product


def _fastest(work: Callable[[], object], batches: int = _BATCHES, repeats: int = _FRAMES) -> float:
    times = []
    for _ in range(batches):
        start = perf_counter()
        for _ in range(repeats):
            work()
        times.append((perf_counter() - start) / repeats)
    return min(times)


def _random(count: int, points: int) -> RBFDeformer:
    """Random vertices in a cube, with the three regions of a face."""
    rng = np.random.default_rng(0)
    vertices = rng.uniform(0.0, 1.0, (count, 3))
    controls = vertices[rng.choice(count, points, replace=False)]
    weights, members = _bands(vertices[:, 1], 0.03), _bands(controls[:, 1], 0.03) > 0
    return RBFDeformer(vertices, controls, weights, members, spacing_factor=0.5)


def _bands(height: NDArray[np.float64], soft: float) -> NDArray[np.float64]:
    """Soft thirds of the unit interval, (3, N)."""
    first, second = (np.clip((height - cut) / (2.0 * soft) + 0.5, 0.0, 1.0) for cut in (1.0 / 3.0, 2.0 / 3.0))
    return np.stack([1.0 - first, first * (1.0 - second), second])


def finer(rig: HeadRig) -> HeadRig:
    """The head with each edge halved and each face of n corners divided into n quads; landmarks are kept."""
    faces = np.asarray(rig.faces, dtype=np.intp)
    corners = (faces >= 0).sum(axis=1)
    count, groups = len(rig.vertices), [faces[corners == n, :n] for n in (3, 4)]
    sides = [np.sort(np.stack([group, np.roll(group, -1, axis=1)], axis=-1), axis=-1) for group in groups]
    keys, places = np.unique(
        np.concatenate([(side[..., 0] * count + side[..., 1]).ravel() for side in sides]), return_inverse=True
    )
    ends = np.divmod(keys, count)
    cut = np.cumsum([group.size for group in groups])[:-1]
    middles = [count + part.reshape(group.shape) for part, group in zip(np.split(places, cut), groups, strict=True)]
    centre = count + len(keys)
    quadrangles = []
    for group, middle in zip(groups, middles, strict=True):
        centres = np.repeat(centre + np.arange(len(group))[:, None], group.shape[1], axis=1)
        quadrangles.append(np.stack([group, middle, centres, np.roll(middle, 1, axis=1)], axis=-1).reshape(-1, 4))
        centre += len(group)

    def with_middles(values: NDArray[np.float64]) -> NDArray[np.float64]:
        halves = (values[ends[0]] + values[ends[1]]) / 2.0
        return np.concatenate([values, halves, *(values[group].mean(axis=1) for group in groups)])

    return replace(
        rig,
        vertices=with_middles(np.asarray(rig.vertices, dtype=np.float64)),
        region_weights=with_middles(np.asarray(rig.region_weights, dtype=np.float64).T).T,
        faces=np.concatenate(quadrangles),
    )
