"""Sets of shape keys that programs expect, as mixtures of ARKit's face units (method.md, section 9.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..face.names import COEFFICIENT_INDEX, COEFFICIENTS
from ..numeric.arrays import FloatArray

OPENS = "jawOpen"
"""ARKit's unit that opens the jaw."""
CLOSES = "mouthClose"
"""ARKit's unit that seals the lips when both are at 1."""
Weights = Mapping[str, float]
"""Weight of each unit; a name without a side stands for both sides."""


@dataclass(frozen=True)
class KeySet:
    """A set of shape keys.

    Attributes
    ----------
    label : str
        Name of the set in the interface.
    keys : dict of str to Weights
        Mixture of units for each key.
    sealed : frozenset of str
        Keys in which the lips touch along their whole length.
    """

    label: str
    keys: Mapping[str, Weights]
    sealed: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the keys, in the order in which they are made."""
        return tuple(self.keys)

    @property
    def mixtures(self) -> FloatArray:
        """Weights of the units in each key, (K, 52)."""
        rows = np.zeros((len(self.keys), len(COEFFICIENTS)))
        for row, weights in zip(rows, self.keys.values(), strict=True):
            for name, weight in weights.items():
                row[_columns(name)] = weight
        return rows


def _columns(name: str) -> list[int]:
    """Columns of a unit, or of both sides of one."""
    if name in COEFFICIENT_INDEX:
        return [COEFFICIENT_INDEX[name]]
    return [COEFFICIENT_INDEX[name + side] for side in ("Left", "Right")]


_BLINK: Mapping[str, Weights] = {"Left": {"eyeBlinkLeft": 1.0}, "Right": {"eyeBlinkRight": 1.0}}
_LOOK: Mapping[str, Weights] = {
    "Up": {"eyeLookUp": 1.0},
    "Down": {"eyeLookDown": 1.0},
    "Left": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
    "Right": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
}
_JOY: Weights = {"mouthSmile": 0.8, "cheekSquint": 0.5, "eyeSquint": 0.3, "mouthUpperUp": 0.1}
_ANGER: Weights = {"browDown": 1.0, "noseSneer": 0.5, "eyeSquint": 0.3, "mouthPress": 0.5, "mouthFrown": 0.2}
_SORROW: Weights = {"browInnerUp": 0.5, "mouthFrown": 0.8, "mouthShrugLower": 0.2, "eyeBlink": 0.15, "eyeSquint": 0.2}
_EASE: Weights = {"mouthSmile": 0.4, "eyeBlink": 0.35, "cheekSquint": 0.2, "browInnerUp": 0.08}
_SURPRISE: Weights = {"browInnerUp": 0.6, "browOuterUp": 0.6, "eyeWide": 1.0, "jawOpen": 0.3, "mouthFunnel": 0.1}
_AA: Weights = {"jawOpen": 0.55, "mouthLowerDown": 0.15, "mouthUpperUp": 0.1}
_IH: Weights = {"jawOpen": 0.14, "mouthStretch": 0.35, "mouthSmile": 0.25, "mouthLowerDown": 0.3, "mouthUpperUp": 0.2}
_OU: Weights = {"mouthPucker": 0.75, "mouthFunnel": 0.2, "jawOpen": 0.1}
_EE: Weights = {"jawOpen": 0.28, "mouthStretch": 0.3, "mouthSmile": 0.1, "mouthLowerDown": 0.25, "mouthUpperUp": 0.1}
_OH: Weights = {"jawOpen": 0.38, "mouthFunnel": 0.5, "mouthPucker": 0.2}
_PP: Weights = {"mouthPress": 0.45, "mouthRollLower": 0.25, "mouthRollUpper": 0.25}
_FF: Weights = {"mouthRollLower": 0.7, "mouthUpperUp": 0.3, "jawOpen": 0.03}
_TH: Weights = {"jawOpen": 0.15, "tongueOut": 0.4, "mouthLowerDown": 0.15, "mouthUpperUp": 0.1}
_DD: Weights = {"jawOpen": 0.1, "mouthLowerDown": 0.25, "mouthUpperUp": 0.15, "mouthStretch": 0.1}
_KK: Weights = {"jawOpen": 0.2, "mouthLowerDown": 0.1, "mouthUpperUp": 0.1, "mouthStretch": 0.1}
_CH: Weights = {"mouthFunnel": 0.5, "mouthShrugUpper": 0.15, "jawOpen": 0.05}
_SS: Weights = {"mouthStretch": 0.25, "mouthSmile": 0.15, "mouthLowerDown": 0.35, "mouthUpperUp": 0.25}
_NN: Weights = {"jawOpen": 0.12, "mouthLowerDown": 0.12, "mouthUpperUp": 0.08}
_RR: Weights = {"mouthFunnel": 0.3, "mouthPucker": 0.25, "jawOpen": 0.1}
"""Mixtures for blinks, looks, emotions and visemes (method.md, section 9.6)."""

KEY_SETS: Mapping[str, KeySet] = {
    "arkit": KeySet("ARKit", {name: {name: 1.0} for name in COEFFICIENTS}),
    "vrm": KeySet(
        "VRM 1",
        {
            "happy": _JOY,
            "angry": _ANGER,
            "sad": _SORROW,
            "relaxed": _EASE,
            "surprised": _SURPRISE,
            **{"aa": _AA, "ih": _IH, "ou": _OU, "ee": _EE, "oh": _OH},
            "blink": {"eyeBlink": 1.0},
            **{f"blink{side}": weights for side, weights in _BLINK.items()},
            **{f"look{way}": weights for way, weights in _LOOK.items()},
            "neutral": {},
        },
    ),
    "vrm0": KeySet(
        "VRM 0",
        {
            "Neutral": {},
            **{"A": _AA, "I": _IH, "U": _OU, "E": _EE, "O": _OH},
            "Blink": {"eyeBlink": 1.0},
            **{"Joy": _JOY, "Angry": _ANGER, "Sorrow": _SORROW, "Fun": _EASE},
            **{f"Look{way}": weights for way, weights in _LOOK.items()},
            **{f"Blink_{side[0]}": weights for side, weights in _BLINK.items()},
        },
    ),
    "oculus": KeySet(
        "Oculus",
        {
            f"viseme_{name}": weights
            for name, weights in {
                **{"sil": {}, "PP": _PP, "FF": _FF, "TH": _TH, "DD": _DD, "kk": _KK, "CH": _CH, "SS": _SS},
                **{"nn": _NN, "RR": _RR, "aa": _AA, "E": _EE, "I": _IH, "O": _OH, "U": _OU},
            }.items()
        },
        frozenset({"viseme_PP"}),
    ),
    "facegen": KeySet(
        "FaceGen",
        {
            "Anger": {**_ANGER, "mouthPress": 0.0, "noseSneer": 0.6, "mouthUpperUp": 0.3, "mouthLowerDown": 0.3},
            "Disgust": {"noseSneer": 0.9, "mouthUpperUp": 0.4, "browDown": 0.4, "eyeSquint": 0.4, "mouthFrown": 0.4},
            "Fear": {"browInnerUp": 0.5, "browOuterUp": 0.2, "eyeWide": 1.0, "mouthStretch": 0.6, "jawOpen": 0.15},
            "Sad": _SORROW,
            "SmileClosed": {**_JOY, "mouthUpperUp": 0.0},
            "SmileOpen": {**_JOY, "mouthUpperUp": 0.3, "mouthLowerDown": 0.25, "jawOpen": 0.15},
            "Surprise": _SURPRISE,
            **{f"Blink{side}": weights for side, weights in _BLINK.items()},
            **{f"BrowDown{side}": {f"browDown{side}": 1.0} for side in _BLINK},
            **{f"BrowIn{side}": {f"browDown{side}": 0.5} for side in _BLINK},
            **{f"BrowUp{side}": {f"browOuterUp{side}": 1.0} for side in _BLINK},
            **{f"Look{way}": _LOOK[way] for way in ("Down", "Left", "Right", "Up")},
            **{f"Squint{side}": {f"eyeSquint{side}": 1.0} for side in _BLINK},
            "Aah": {**_AA, "jawOpen": 0.35},
            "BigAah": {**_AA, "jawOpen": 0.7},
            **{"BMP": _PP, "ChJSh": _CH, "DST": _SS},
            "Eee": _IH,
            "Eh": _EE,
            "FV": _FF,
            "I": {**_EE, "jawOpen": 0.2},
            **{"K": _KK, "N": _NN, "Oh": _OH, "OohQ": _OU, "R": _RR, "Th": _TH},
            "W": {"mouthPucker": 0.9, "mouthFunnel": 0.1},
        },
        frozenset({"BMP"}),
    ),
}
"""Sets by the name that the command line uses."""
RESTS = frozenset(name for keys in KEY_SETS.values() for name, weights in keys.keys.items() if not weights)
"""Keys that move nothing, as they stand for a face at rest."""
