"""The limit of learning from expressions: each expression from all others of the same head.

The error of a kernel of distance is regressed on the landmarks' displacements, with near landmarks preferred, over all
expressions but one and its mirror image. Another head's expressions cannot be expected to reveal more than a head's
own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facemime.core.heads.kernels import distances, gaussian
from lab.bench.deformers import regions
from lab.bench.heads import AREAS, TrueHead

_VERTICES = 500
_NEAR = 0.3
"""Reach of a landmark in outer-eye distances."""
_RIDGE = 0.03
"""Ridge as a share of the landmarks' mean squared displacement."""


def left_out_errors(head: TrueHead) -> list[dict[str, float]]:
    """Errors by area of single expressions: of the kernel of distance, and with a correction learnt from the others."""
    rng = np.random.default_rng(2019)
    chosen = rng.choice(np.flatnonzero(head.regions.any(axis=0)), _VERTICES, replace=False)
    moved = head.motions[:, head.landmarks].astype(np.float64)
    true = head.motions[:, chosen]
    wrong = true - regions(head)(moved.astype(np.float32))[:, chosen]
    near = gaussian(distances(head.vertices[chosen], head.vertices[head.landmarks]), _NEAR)
    names = np.array([_sideless(name) for name in head.names])
    left = np.empty_like(wrong)
    for i, name in enumerate(names):
        others = names != name
        left[i] = wrong[i] - np.einsum("vp,pc->vc", _regressed(moved[others], wrong[others], near), moved[i])
    size = np.linalg.norm(true, axis=2)
    masks = {area: head.areas[area][chosen] for area in AREAS}
    return [
        {area: float(np.linalg.norm(off, axis=2)[:, mask].sum() / size[:, mask].sum()) for area, mask in masks.items()}
        for off in (wrong, left)
    ]


def _regressed(
    moved: NDArray[np.float64], wrong: NDArray[np.float32], near: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weights of the landmarks, (V, 66), by a ridge regression per vertex that penalises distant landmarks."""
    inputs = moved.transpose(0, 2, 1).reshape(-1, moved.shape[1])
    outputs = wrong.transpose(0, 2, 1).reshape(-1, wrong.shape[1])
    scale = float(np.square(inputs).sum(axis=0).mean())
    gram, products = inputs.T @ inputs / scale, outputs.T @ inputs / scale
    system = near[:, :, None] * gram * near[:, None, :] + _RIDGE * np.eye(len(gram))
    return near * np.linalg.solve(system, (near * products)[..., None])[..., 0]


def _sideless(name: str) -> str:
    for side in ("_L", "_R", "Left", "Right"):
        name = name.removesuffix(side)
    return name
