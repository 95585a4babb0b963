"""What the controls of a rig do to a face, as arrows on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numeric.arrays import FloatArray, IntArray
from .rig_map import PROPERTY, RigMap

_MOST = 40
"""Largest number of arrows of a single direction of a control."""
_SHARE = 0.25
"""Motion of a vertex, relative to the largest, below which it has no arrow."""
_LENGTH = 0.2
"""Length of the longest arrow of a control, in eye distances."""
AXES = 4
"""Number of kinds of arrows: the three axes of a control, and properties."""


@dataclass(frozen=True)
class Arrows:
    """Arrows that start at vertices (A,), and their vectors (A, 3) in the head frame, in the unit of the mesh.

    `axes` (A,) are the axes of the control, or 3 for a property.
    """

    vertices: IntArray
    vectors: FloatArray
    axes: IntArray


def control_arrows(rig_map: RigMap, control: str) -> Arrows:
    """Return how a control moves the face: an arrow at the vertices that each of its directions moves most."""
    own = [k for k in range(len(rig_map.channel)) if rig_map.channels[rig_map.channel[k]].control == control]
    parts = [_spread(rig_map, k) for k in own]
    if not parts:
        return Arrows(np.empty(0, dtype=np.intp), np.empty((0, 3)), np.empty(0, dtype=np.intp))
    vertices, vectors, axes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Arrows(vertices, vectors, axes)


def all_arrows(rig_map: RigMap) -> Arrows:
    """Return an arrow for each control, where and how it moves the face most."""
    sizes = np.linalg.norm(rig_map.effects, axis=2)
    most = sizes.max(axis=1, initial=0.0)
    best: dict[str, int] = {}
    for k in np.argsort(-most, kind="stable").tolist():
        best.setdefault(rig_map.channels[rig_map.channel[k]].control, k)
    chosen = np.array(list(best.values()), dtype=np.intp)
    places = sizes[chosen].argmax(axis=1) if len(chosen) else chosen
    vectors = rig_map.effects[chosen, places] * (_LENGTH * rig_map.unit / np.maximum(most[chosen], 1e-30))[:, None]
    return Arrows(
        rig_map.sample[places], vectors, np.array([_axis(rig_map, k) for k in chosen.tolist()], dtype=np.intp)
    )


def _spread(rig_map: RigMap, k: int) -> tuple[IntArray, FloatArray, IntArray]:
    """Arrows of a direction of a control, at vertices that are spread over what it moves."""
    size = np.linalg.norm(rig_map.effects[k], axis=1)
    most = float(size.max(initial=1e-30))
    # The landmarks come first in the sample, and outline the face best.
    moved = np.flatnonzero(size >= _SHARE * most)[:_MOST]
    vectors = rig_map.effects[k][moved] * (_LENGTH * rig_map.unit / most)
    return rig_map.sample[moved], vectors, np.full(len(moved), _axis(rig_map, k), dtype=np.intp)


def _axis(rig_map: RigMap, k: int) -> int:
    channel = rig_map.channels[rig_map.channel[k]]
    return AXES - 1 if channel.kind == PROPERTY else channel.index
