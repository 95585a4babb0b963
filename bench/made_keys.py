"""ARKit's keys made on a head: how well they close lids and lips, and how far they are from the head's own keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import bpy
import numpy as np
from numpy.typing import NDArray

from facemime.blender.characters import members_of, read_kinds
from facemime.core.coefficient_names import COEFFICIENT_INDEX
from facemime.core.drive.expression_keys import expression_keys
from facemime.core.drive.key_quality import key_qualities
from facemime.core.drive.key_sets import KEY_SETS
from facemime.core.heads.parts import Part
from facemime.core.heads.rig import HeadRig

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
    """

    eyes: float
    lips: float
    crossing: float
    most: int
    own: float = float("nan")
    scaled: float = float("nan")


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


def made_keys(head: bpy.types.Object, rig: HeadRig, own: Keys) -> Made:
    """Make ARKit's keys on a head, measure them, and compare them with its own keys, if it has any."""
    names, motions = expression_keys(rig, _ARKIT)
    skin = np.flatnonzero(read_kinds(head.data) == Part.SKIN)
    pairs = [(motions[names.index(name)][skin], true[skin]) for name, true in own.items() if name in names]
    total = sum(_length(true) for _, true in pairs)
    if not pairs:
        return measured_keys(rig, motions)
    return replace(
        measured_keys(rig, motions),
        own=sum(_length(ours - true) for ours, true in pairs) / total,
        scaled=sum(_length(_fitting(ours, true) - true) for ours, true in pairs) / total,
    )


def _length(motion: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(motion, axis=1).sum())


def _fitting(ours: NDArray[np.floating], true: NDArray[np.floating]) -> NDArray[np.floating]:
    return ours * ((ours * true).sum() / max(float(np.square(ours).sum()), 1e-12))


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
