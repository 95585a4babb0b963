"""Strengths of the parts of a face in a bake, which the user may animate: more smile from here to there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.drive.driver import HeadMotion
from ...core.face.rotation import limit_rotation
from ...core.heads.key_presets import curve_groups, gaze_keys
from ...core.numeric.arrays import FloatArray
from ..fcurves import curves_in
from .bake_keys import RESIDUAL, MeshKeys

GAZE = "Gaze"
STRENGTHS = {
    "Brows": "strength_brows",
    "Eyes": "strength_eyes",
    "Cheeks and Nose": "strength_cheeks",
    "Jaw": "strength_jaw",
    "Mouth": "strength_mouth",
    GAZE: "strength_gaze",
}
"""For each group of curves, and for what shows the gaze, the property of a head's object that scales it."""


def scaled(
    head: bpy.types.Object, keys: MeshKeys, values: FloatArray, frames: NDArray[np.floating[Any]], added: Sequence[str]
) -> FloatArray:
    """Scale values (N, K) of keys in some frames by the strengths of a head, within the ranges of the keys.

    Residual keys, which are those `added`, move several parts, and are scaled by the mean strength.
    """
    strengths = {group: _at(head, f"facemime.{name}", frames) for group, name in STRENGTHS.items()}
    every = np.column_stack(list(strengths.values()))
    if (every == 1.0).all():
        return values
    named = [name for name in keys.names if name not in added]
    groups = {**curve_groups(named), **dict.fromkeys(gaze_keys(named), GAZE), **dict.fromkeys(added, RESIDUAL)}
    mean = np.mean([strength for group, strength in strengths.items() if group != GAZE], axis=0)
    factors = np.column_stack([strengths.get(groups[name], mean) for name in keys.names])
    # A value that was out of its range before stays there.
    low, high = np.minimum(keys.lower, values), np.maximum(keys.upper, values)
    return np.asarray(np.clip(factors * values, low, high))


def scaled_pose(head: bpy.types.Object, motion: HeadMotion, frames: NDArray[np.floating[Any]]) -> HeadMotion:
    """Scale the rotations of jaw and eyes in some frames by the strengths of a head."""
    jaw, gaze = (_at(head, f"facemime.{STRENGTHS[part]}", frames) for part in ("Jaw", GAZE))
    eyes = [_turned(motion.gaze[:, side], gaze) for side in range(2)]
    return replace(motion, jaw=_turned(motion.jaw, jaw), gaze=np.stack(eyes, axis=1))


def _turned(rotations: FloatArray, strengths: FloatArray) -> FloatArray:
    if (strengths == 1.0).all():
        return rotations
    return np.array([limit_rotation(one, by, pi) for one, by in zip(rotations, strengths.tolist(), strict=True)])


def _at(head: bpy.types.Object, path: str, frames: NDArray[np.floating[Any]]) -> FloatArray:
    """Return a property of a head in some frames, (N,): by its curve in the active action, or its value."""
    found = (curve for curve in curves_in(head.animation_data) if curve.data_path == path and not curve.mute)
    curve = next(found, None)
    if curve is not None:
        return np.array([curve.evaluate(frame) for frame in frames], dtype=np.float64)
    group = getattr(head, "facemime", None)  # the extension may not be registered
    return np.full(len(frames), getattr(group, path.rpartition(".")[2], 1.0))
