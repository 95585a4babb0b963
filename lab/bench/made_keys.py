"""ARKit's keys made on a head: how well they close lids and lips, and how far they are from the head's own keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import bpy
import numpy as np
from numpy.typing import NDArray

from facemime.blender.characters import members_of, read_kinds
from facemime.core.bake.expression_keys import expression_keys
from facemime.core.bake.key_quality import key_qualities
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.heads.rig import HeadRig, Part

_ARKIT = KEY_SETS["arkit"]
_MOST_OF_52 = 40
"""Keys that have to move vertices for a head to count as having ARKit's keys."""
Keys = Mapping[str, NDArray[np.floating]]
"""Motion of the vertices of a head, (V, 3), in each of the keys that came with it."""


@dataclass(frozen=True)
class Made:
    """Quality of ARKit's keys made on a head: gaps, intersections, and the difference from its own keys.

    Attributes
    ----------
    eyes, lips : float
        As in `KeyQuality`, of the worst key.
    crossing : float
        Number of triangles that intersect others, mean over the keys.
    most : int
        The same, of the worst key.
    own : float
        Mean error over mean motion, against the keys that came with the head; NaN without such keys.
    scaled : float
        The same, with each key scaled by the factor that fits best.
    mixed : float
        The same, with each key replaced by the mixture of all 52 that fits best.
    """

    eyes: float
    lips: float
    crossing: float
    most: int
    own: float = float("nan")
    scaled: float = float("nan")
    mixed: float = float("nan")


def in_order(rig: HeadRig, own: Keys) -> NDArray[np.float32]:
    """Return motions of a head's own keys as `expression_keys` returns them, 0 for keys and parts that it lacks."""
    motions = np.zeros((len(_ARKIT.names), len(rig.all_vertices), 3), dtype=np.float32)
    for row, name in enumerate(_ARKIT.names):
        if name in own:
            motions[row, : len(own[name])] = own[name]
    return motions


def measured_keys(rig: HeadRig, motions: NDArray[np.float32]) -> Made:
    """Measure keys (52, V, 3) of a head, in the order of ARKit's set."""
    qualities = key_qualities(rig, _ARKIT, motions)
    crossing = [quality.crossing for quality in qualities]
    return Made(
        eyes=float(np.nanmax([quality.eyes for quality in qualities])),
        lips=float(np.nanmax([quality.lips for quality in qualities])),
        crossing=float(np.mean(crossing)),
        most=max(crossing),
    )


@dataclass(frozen=True)
class Pair:
    """Keys of the skin of a head.

    Attributes
    ----------
    made : (52, V, 3) float64
        The keys made on it.
    own : (52, V, 3) float64
        The keys that came with it.
    known : (52,) bool
        Which of these there are.
    """

    made: NDArray[np.float64]
    own: NDArray[np.float64]
    known: NDArray[np.bool_]

    def error(self, made: NDArray[np.float64]) -> float:
        """Mean error over mean motion of keys (52, V, 3)."""
        return _length(made[self.known] - self.own[self.known]) / _length(self.own[self.known])

    def mixtures(self) -> NDArray[np.float64]:
        """Amounts of the made keys in each key, (52, 52), that fit the own keys best."""
        made, own = self.made.reshape(len(self.made), -1), self.own.reshape(len(self.own), -1)
        amounts = np.eye(len(made))
        amounts[self.known] = np.linalg.lstsq(made.T, own[self.known].T, rcond=1e-6)[0].T
        return amounts

    def scaled(self) -> NDArray[np.float64]:
        """The made keys, each multiplied by the factor that fits best."""
        products, squares = (self.made * self.own).sum(axis=(1, 2)), np.square(self.made).sum(axis=(1, 2))
        return self.made * (products / np.maximum(squares, 1e-12))[:, None, None]


def made_keys(head: bpy.types.Object, rig: HeadRig, own: Keys) -> tuple[Made, Pair | None]:
    """Make ARKit's keys on a head, measure them, and compare them with its own keys, if it has any."""
    _, motions = expression_keys(rig, _ARKIT)
    measured = measured_keys(rig, motions)
    if not own:
        return measured, None
    skin = np.flatnonzero(read_kinds(head.data) == Part.SKIN)
    known = np.array([name in own for name in _ARKIT.names])
    pair = Pair(motions[:, skin].astype(float), in_order(rig, own)[:, skin].astype(float), known)
    errors = [pair.error(made) for made in (pair.made, pair.scaled(), mixed(pair, pair))]
    return replace(measured, **dict(zip(("own", "scaled", "mixed"), errors, strict=True))), pair


def mixed(pair: Pair, fitted: Pair) -> NDArray[np.float64]:
    """Mixtures of the keys made on a head (52, V, 3) that fit the own keys of another best."""
    return np.asarray((fitted.mixtures() @ pair.made.reshape(len(pair.made), -1)).reshape(pair.made.shape))


def _length(motion: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(motion, axis=-1).sum())


def own_keys(head: bpy.types.Object) -> Keys:
    """Return the keys with ARKit's names that came with a head; none if there are few."""
    found = head.data.shape_keys
    if found is None:
        return {}
    member, places = members_of(head)[0], {}
    for block in found.key_blocks:
        places[block.name] = np.empty(3 * len(head.data.vertices), dtype=np.float32)
        block.data.foreach_get("co", places[block.name])
    rest = places[found.reference_key.name]
    moving = {name: place for name, place in places.items() if name in COEFFICIENT_INDEX and (place != rest).any()}
    if len(moving) < _MOST_OF_52:
        return {}
    return {name: member.head_offsets((place - rest).reshape(-1, 3)) for name, place in moving.items()}
