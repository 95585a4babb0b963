"""Coefficients that make a head look as the driven one does: a fit to its landmarks near what was acted (method.md,
section 9.3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import (
    BROWS,
    LIPS,
    LOWER_LIDS,
    LOWER_LIPS,
    MOUTH_CORNERS,
    N_LANDMARKS,
    UPPER_LIDS,
    UPPER_LIPS,
    outer_eye_distance,
)
from ..face.names import COEFFICIENT_INDEX, COEFFICIENTS, EXCLUSIVE
from ..heads.built_in import load_head
from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply
from ..takes.face_space import without_similarity
from .fit import fit_weights

_NEAR = 0.3
"""`nu` of equation 9.7: weight of the distance from what was acted, relative to the mean square of a key's features."""
_UPPER = ("brow", "eyeBlink", "eyeWide", "eyeSquint")
_LOWER = (
    *("jawOpen", "mouthClose", "mouthSmile", "mouthFrown", "mouthStretch", "mouthPucker", "mouthFunnel"),
    *("mouthLeft", "mouthRight", "mouthUpperUp", "mouthLowerDown"),
)
"""Coefficients that landmarks of the upper and of the lower face show; what was measured of the others stays."""
_ASIDE = {_UPPER: 0.3, _LOWER: 0.5}
"""Weight of sideways motion in either half, relative to that up and down: brows move up and down."""
_GAP = 2.0
"""Weight of the gap between lids, and between lips."""
_CORNER = 2.0
"""Weight of the corners of the mouth."""
_NEARLY_SHUT = 0.8
"""How far lids are closed, as a share, from which a blink is at least that."""
_SHUT = 0.95
"""How far they are closed when a blink is 1."""
_OPENS, _CLOSES = COEFFICIENT_INDEX["jawOpen"], COEFFICIENT_INDEX["mouthClose"]
_EYES = ("Right", "Left")
_BLINKS = [COEFFICIENT_INDEX[f"eyeBlink{side}"] for side in _EYES]
_WIDES = [COEFFICIENT_INDEX[f"eyeWide{side}"] for side in _EYES]


@dataclass(frozen=True)
class _Half:
    """Coefficients of a half of the face, `keys` (K,), and how features (D,) of it depend on landmarks, (198, D).

    `effects` (52, D) are the features of the built-in head's units, and `apart` pairs of places in `keys`.
    """

    keys: NDArray[np.intp]
    features: FloatArray
    effects: FloatArray
    apart: list[tuple[int, int]]


def alike(coefficients: FloatArray, moved: FloatArray) -> FloatArray:
    """Return coefficients (N, 52) near the given ones with which the built-in head looks as it is driven.

    `moved` (N, 198) are the displacements of its landmarks without those of the whole head, in outer-eye distances.
    Eyes that are seen shut are shut.
    """
    out = coefficients.copy()
    for half in _halves():
        own = half.effects[half.keys]
        fixed = np.delete(out, half.keys, axis=1), np.delete(half.effects, half.keys, axis=0)
        wanted = multiply(moved, half.features) - multiply(*fixed)
        # A coefficient's distance from what was acted is another feature of it.
        pull = np.sqrt(_NEAR * float(np.square(own).sum()) / len(own))
        keys = np.concatenate([own, pull * np.eye(len(own))], axis=1)
        motion = np.concatenate([wanted, pull * out[:, half.keys]], axis=1)
        bounds = np.zeros(len(own)), np.ones(len(own))
        out[:, half.keys] = fit_weights(motion[..., None], keys[..., None], *bounds, half.apart)
    out[:, _CLOSES] = np.minimum(out[:, _CLOSES], out[:, _OPENS])
    return _blinking(out, moved)


def _blinking(coefficients: FloatArray, moved: FloatArray) -> FloatArray:
    """Let eyes that are seen nearly shut blink as far, in place."""
    lids = moved.reshape(-1, N_LANDMARKS, 3)
    opening = (lids[:, LOWER_LIDS, 1] - lids[:, UPPER_LIDS, 1]).reshape(-1, 2, 2).mean(axis=2)
    closed = -opening / _open_eyes()
    steep = (1.0 - _NEARLY_SHUT) / (_SHUT - _NEARLY_SHUT)
    least = np.where(closed > _NEARLY_SHUT, np.minimum(_NEARLY_SHUT + steep * (closed - _NEARLY_SHUT), 1.0), 0.0)
    coefficients[:, _BLINKS] = np.maximum(coefficients[:, _BLINKS], least)
    coefficients[:, _WIDES] = np.where(least > 0.0, 0.0, coefficients[:, _WIDES])
    return coefficients


@lru_cache(maxsize=1)
def _open_eyes() -> FloatArray:
    """Opening of the built-in head's right and left eye at rest, (2,), in outer-eye distances."""
    landmarks = _landmarks()
    return np.asarray((landmarks[LOWER_LIDS, 1] - landmarks[UPPER_LIDS, 1]).reshape(2, 2).mean(axis=1))


@lru_cache(maxsize=1)
def _halves() -> tuple[_Half, _Half]:
    head, rest = load_head(), _landmarks()
    units = head.units[:, head.landmarks] / outer_eye_distance(head.vertices[head.landmarks])
    units = without_similarity(units.astype(np.float64), rest).reshape(len(units), -1)

    def half(names: tuple[str, ...], features_of: Callable[[FloatArray], list[FloatArray]]) -> _Half:
        every = np.eye(rest.size).reshape(-1, *rest.shape)
        features = np.concatenate([part.reshape(rest.size, -1) for part in features_of(every)], axis=1)
        keys = np.array([k for k, name in enumerate(COEFFICIENTS) if name.startswith(names)])
        place = {int(k): i for i, k in enumerate(keys)}
        apart = [(place[one], place[other]) for one, other in EXCLUSIVE.tolist() if one in place and other in place]
        return _Half(keys, features, multiply(units, features), apart)

    return half(_UPPER, _upper), half(_LOWER, _lower)


def _landmarks() -> FloatArray:
    """Landmarks of the built-in head at rest, (66, 3), in outer-eye distances."""
    head = load_head()
    landmarks = head.vertices[head.landmarks].astype(np.float64)
    return np.asarray(landmarks / outer_eye_distance(landmarks))


def _upper(moved: FloatArray) -> list[FloatArray]:
    """Features of brows and lids, of displacements (N, 66, 3)."""
    upper, lower = moved[:, UPPER_LIDS, 1], moved[:, LOWER_LIDS, 1]
    return [moved[:, BROWS, 1], _ASIDE[_UPPER] * moved[:, BROWS, 0], upper, _GAP * (lower - upper)]


def _lower(moved: FloatArray) -> list[FloatArray]:
    """Features of the lips, of displacements (N, 66, 3)."""
    gap = moved[:, LOWER_LIPS, 1] - moved[:, UPPER_LIPS, 1]
    corners = moved[:, MOUTH_CORNERS, :2]
    return [moved[:, LIPS, 1], _ASIDE[_LOWER] * moved[:, LIPS, 0], _GAP * gap, _CORNER * corners]
