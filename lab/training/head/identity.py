"""Identity of the head: MakeHuman's macro targets (gender, age, build, origin) and details, combined into one face."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .source import Source


@dataclass(frozen=True)
class Identity:
    """Weights of one person; `details` maps identity targets to their weight, "*-" stands for "l-" and "r-".

    `gender` runs from 0, female, to 1, male; `age` from 0, young, to 1, old; `muscle` and `weight` from 0 to 1 with
    0.5 average; `origins` are normalised to a sum of 1.
    """

    gender: float
    age: float
    muscle: float = 0.5
    weight: float = 0.5
    proportions: float = 0.6
    origins: dict[str, float] = field(default_factory=lambda: {"caucasian": 1.0})
    details: dict[str, float] = field(default_factory=dict)


AVATAR = Identity(
    gender=0.78,
    age=0.1,
    muscle=0.55,
    weight=0.46,
    proportions=0.75,
    origins={"caucasian": 0.6, "asian": 0.2, "african": 0.2},
)

WOMAN = Identity(
    gender=0.02,
    age=0.08,
    muscle=0.45,
    weight=0.48,
    proportions=0.85,
    origins={"caucasian": 0.75, "asian": 0.1, "african": 0.15},
    details={
        "chin/chin-width-decr": 0.55,
        "head/head-oval": 0.35,
        "forehead/forehead-scale-vert-decr": 0.45,
        "nose/nose-scale-horiz-decr": 0.35,
        "nose/nose-scale-vert-decr": 0.25,
        "eyes/*-eye-scale-incr": 0.25,
    },
)


def identity_offsets(source: Source, identity: Identity) -> NDArray[np.float64]:
    """Offsets in decimetres, (N, 3), from the base mesh to `identity`, combined as MakeHuman combines its macros."""
    offsets = np.zeros((source.size, 3))
    genders = {"female": 1.0 - identity.gender, "male": identity.gender}
    ages = {"young": 1.0 - identity.age, "old": identity.age}
    muscles = _levels(identity.muscle, "muscle")
    weights = _levels(identity.weight, "weight")
    total = sum(identity.origins.values())
    for (gender, g), (age, a) in product(genders.items(), ages.items()):
        for origin, o in identity.origins.items():
            offsets += _weighted(source, f"macrodetails/{origin}-{gender}-{age}", g * a * o / total)
        for (muscle, m), (weight, w) in product(muscles.items(), weights.items()):
            build = f"{gender}-{age}-{muscle}-{weight}"
            offsets += _weighted(source, f"macrodetails/universal-{build}", g * a * m * w)
            ideal = f"macrodetails/proportions/{build}-idealproportions"
            offsets += _weighted(source, ideal, g * a * m * w * identity.proportions)
    for name, value in identity.details.items():
        for side in ("l-", "r-") if "*-" in name else ("",):
            offsets += value * source.target(name.replace("*-", side))
    return offsets


def _levels(value: float, kind: str) -> dict[str, float]:
    low, high = max(0.0, 1.0 - 2.0 * value), max(0.0, 2.0 * value - 1.0)
    return {f"min{kind}": low, f"average{kind}": 1.0 - low - high, f"max{kind}": high}


def _weighted(source: Source, name: str, weight: float) -> NDArray[np.float64]:
    if weight == 0.0 or not source.has_target(name):
        return np.zeros((source.size, 3))
    return weight * source.target(name)
