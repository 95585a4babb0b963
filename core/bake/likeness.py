"""Coefficients that make a head look as the driven one does: a fit to its landmarks near what was acted (method.md,
section 9.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import (
    BROWS,
    CHIN,
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
from ..heads.built_in import landmarks_at_rest, load_head
from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_minimum
from ..numeric.linalg import multiply
from ..takes.face_space import without_similarity

_NEAR = 0.3
"""`nu` of equation 9.7: weight of the distance from what was acted, relative to the mean square of a key's features.
Chosen on half A of the strangers' clips and the rendered performers: with 0.2 less of these, with 1 less of those."""
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
_CORNER = 3.0
"""Weight of the corners of the mouth, chosen on half A of the strangers' clips, where 2 and 4 are nearly as good. Of
the weight of the gap between lids, 4 is as good."""
_CHIN = 1.5
"""Weight of the chin, which shows whether the jaw opens or only the lips part over clenched teeth. Chosen on half A,
where jaw and lips agree better from 0 to 2, and smiles a little worse."""
_NEARLY_SHUT = 0.8
"""How far lids are closed, as a share, from which a blink is at least that. From 0.7, clips compare alike."""
_SHUT = 0.95
"""How far they are closed when a blink is 1."""
_OPENS, _CLOSES = COEFFICIENT_INDEX["jawOpen"], COEFFICIENT_INDEX["mouthClose"]
_CLENCHED = 0.75
"""Share of the jaw's opening that is taken back where teeth are shut. Where lips are parted as far, MediaPipe's jawOpen
over shut teeth is 0.23 of that over an open jaw on half A of the strangers' clips, on which this was chosen, and 0.5 on
half B. With 1, frames of different people compare worse with it, by 0.09 / 0.27 instead of 0.03 / 0.11."""
_ROUND = [COEFFICIENT_INDEX["mouthFunnel"], COEFFICIENT_INDEX["mouthPucker"]]
"""Coefficients that do not make up for it: they would hide the teeth."""
_EYES = ("Right", "Left")
_BLINKS = [COEFFICIENT_INDEX[f"eyeBlink{side}"] for side in _EYES]
_WIDES = [COEFFICIENT_INDEX[f"eyeWide{side}"] for side in _EYES]


@dataclass(frozen=True)
class _Half:
    """Coefficients of a half of the face, `keys` (K,), and the normal equations of their fit.

    `readout` (198, K) and `fixed` (52, K) are the products of the features of displacements, and of all units, with
    those of the keys; `fixed` is 0 for the keys themselves. `gram` (K, K) are those of the keys, with the ridge `pull`.
    `opposite` (K,) are the places in `keys` of those that exclude them, or -1.
    """

    keys: NDArray[np.intp]
    readout: FloatArray
    fixed: FloatArray
    gram: FloatArray
    pull: float
    opposite: NDArray[np.intp]


def alike(coefficients: FloatArray, moved: FloatArray, teeth: FloatArray | None = None) -> FloatArray:
    """Return coefficients (N, 52) near the given ones with which the built-in head looks as it is driven.

    `moved` (N, 198) are the displacements of its landmarks, in outer-eye distances. Of each exclusive pair, one has to
    be 0, and is afterwards. Eyes that are seen shut are shut, and jaws open less whose `teeth` (N,), as in
    `TrackResult`, are.
    """
    out = coefficients.copy()
    shut = np.zeros(len(out)) if teeth is None else np.nan_to_num(teeth)
    for half in _halves():
        acted = coefficients[:, half.keys]
        products = multiply(moved, half.readout) - multiply(coefficients, half.fixed) + half.pull * acted
        lower, upper = np.zeros(len(half.keys)), np.ones(len(half.keys))
        for row, (product, start) in enumerate(zip(products, acted, strict=True)):
            out[row, half.keys] = bounded_minimum(half.gram, product, lower, upper, start, half.opposite)
            if shut[row] > 0.0 and len(jaw := np.flatnonzero(half.keys == _OPENS)):
                # The lips open again, with less of the jaw.
                less, rounded = upper.copy(), np.isin(half.keys, _ROUND)
                less[jaw] = (1.0 - _CLENCHED * shut[row]) * out[row, _OPENS]
                less[rounded] = out[row, half.keys[rounded]]
                out[row, half.keys] = bounded_minimum(half.gram, product, lower, less, start, half.opposite)
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
    landmarks = landmarks_at_rest()
    opening = (landmarks[LOWER_LIDS, 1] - landmarks[UPPER_LIDS, 1]).reshape(2, 2).mean(axis=1)
    return np.asarray(opening / outer_eye_distance(landmarks))


@lru_cache(maxsize=1)
def _halves() -> tuple[_Half, _Half]:
    head, rest = load_head(), landmarks_at_rest()
    unit = outer_eye_distance(rest)
    units = head.units[:, head.landmarks].reshape(len(COEFFICIENTS), -1).astype(np.float64) / unit
    every = np.eye(rest.size).reshape(-1, *rest.shape)
    still = without_similarity(every, rest / unit)

    def half(names: tuple[str, ...], parts: list[FloatArray]) -> _Half:
        features = np.concatenate([part.reshape(rest.size, -1) for part in parts], axis=1)
        keys = np.array([k for k, name in enumerate(COEFFICIENTS) if name.startswith(names)])
        effects = multiply(units, features)
        own = effects[keys]
        fixed = multiply(effects, own.T)
        fixed[keys] = 0.0
        pull = _NEAR * float(np.square(own).sum()) / len(own)
        gram = multiply(own, own.T) + pull * np.eye(len(own))
        opposite = np.full(len(keys), -1)
        pairs = np.searchsorted(keys, EXCLUSIVE[np.isin(EXCLUSIVE, keys).all(axis=1)])
        opposite[pairs] = pairs[:, ::-1]
        return _Half(keys, multiply(features, own.T), fixed, gram, pull, opposite)

    return half(_UPPER, _upper(still)), half(_LOWER, _lower(still, every))


def _upper(moved: FloatArray) -> list[FloatArray]:
    """Features of brows and lids, of displacements (N, 66, 3) without those of the whole head."""
    upper, lower = moved[:, UPPER_LIDS, 1], moved[:, LOWER_LIDS, 1]
    return [moved[:, BROWS, 1], _ASIDE[_UPPER] * moved[:, BROWS, 0], upper, _GAP * (lower - upper)]


def _lower(moved: FloatArray, chin: FloatArray) -> list[FloatArray]:
    """Features of the lips, of displacements (N, 66, 3) without those of the whole head, and of the `chin`, with them:
    otherwise an opening jaw looks like a rising upper lip and a falling lower one.
    """
    gap = moved[:, LOWER_LIPS, 1] - moved[:, UPPER_LIPS, 1]
    corners = moved[:, MOUTH_CORNERS, :2]
    lips = [moved[:, LIPS, 1], _ASIDE[_LOWER] * moved[:, LIPS, 0], _GAP * gap, _CORNER * corners]
    return [*lips, _CHIN * chin[:, CHIN, 1]]
