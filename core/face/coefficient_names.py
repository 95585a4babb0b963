"""Names of ARKit's 52 coefficients, and the pairs that exclude each other."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_SIDED = (
    *("browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp"),
    *("eyeSquint", "eyeWide", "mouthDimple", "mouthFrown", "mouthLowerDown", "mouthPress", "mouthSmile"),
    *("mouthStretch", "mouthUpperUp", "noseSneer"),
)
_SINGLE = (
    *("browInnerUp", "cheekPuff", "jawForward", "jawLeft", "jawOpen", "jawRight", "mouthClose", "mouthFunnel"),
    *("mouthLeft", "mouthPucker", "mouthRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower"),
    *("mouthShrugUpper", "tongueOut"),
)
COEFFICIENTS = tuple(sorted([*_SINGLE, *(name + side for name in _SIDED for side in ("Left", "Right"))]))
"""Names of the 52 coefficients, alphabetically; left and right are the performer's own."""
COEFFICIENT_INDEX = {name: i for i, name in enumerate(COEFFICIENTS)}
"""Column of each coefficient."""
N_COEFFICIENTS = len(COEFFICIENTS)
FITTED: NDArray[np.intp] = np.array([i for i, name in enumerate(COEFFICIENTS) if not name.startswith("eyeLook")])
"""(44,) columns of the coefficients that are fitted: all but the eight of the eyes' direction."""
_LOOKS = (("eyeLookDown", "eyeLookUp"), ("eyeLookIn", "eyeLookOut"))
EXCLUSIVE_NAMES = (
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("eyeBlinkLeft", "eyeWideLeft"),
    ("eyeBlinkRight", "eyeWideRight"),
    ("mouthSmileLeft", "mouthFrownLeft"),
    ("mouthSmileRight", "mouthFrownRight"),
    *((one + side, other + side) for one, other in _LOOKS for side in ("Left", "Right")),
)
"""Coefficients that exclude each other, as their motions are opposite."""
EXCLUSIVE: NDArray[np.intp] = np.array(
    [[COEFFICIENT_INDEX[name] for name in pair] for pair in EXCLUSIVE_NAMES if not pair[0].startswith("eyeLook")]
)
"""(P, 2) columns of those that are fitted."""


def _mirrored(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    return name.removesuffix("Right") + "Left" if name.endswith("Right") else name


COEFFICIENT_MIRROR: NDArray[np.intp] = np.array([COEFFICIENT_INDEX[_mirrored(name)] for name in COEFFICIENTS])
"""(52,) mirror image of each coefficient: ``a[COEFFICIENT_MIRROR]`` are the coefficients of a face that was flipped
left to right."""


def _spellings() -> dict[str, int]:
    """Column of each coefficient by its spellings as letters in lower case: `eyeblinkleft` and `eyeblinkl`."""
    found = {}
    for name, column in COEFFICIENT_INDEX.items():
        found[name.lower()] = column
        for side in ("Left", "Right"):
            if name.endswith(side):
                found[f"{name.removesuffix(side)}{side[0]}".lower()] = column
    return found


SPELLINGS: Mapping[str, int] = _spellings()
_SUFFIX = re.compile(r"[.|:/](?:weight|value)s?$|[\])]$", re.IGNORECASE)
_PREFIX = re.compile(r"^.*[.|:/\[(](?=...)")
"""That of a node, but not the name before the `.L` of a side."""
_SET = re.compile(r"^(?:arkit|blendshapes?|bs)")
"""Names of the set that some programs put before those of its coefficients."""


@lru_cache(maxsize=1024)
def column_of(name: str) -> int | None:
    """Return the column of a coefficient by any of its usual names, or None for other names.

    Capitals and what separates words do not matter, as in `eye_blink_left` or `EyeBlink_L`, nor does the name of a node
    or a set, as in `blendShapes.EyeBlinkLeft`, `Head|jawOpen` or `weights[jawOpen]`.
    """
    letters = re.sub(r"[\W_]", "", _PREFIX.sub("", _SUFFIX.sub("", name.strip()))).lower()
    found = SPELLINGS.get(letters)
    return SPELLINGS.get(_SET.sub("", letters)) if found is None else found
