"""Facial actions that no landmark shows, such as a tongue that is out or a puffed cheek.

Each is measured as an activation from 0 to about 1, with the names and the meaning of ARKit's coefficients. Those with
a side have one value per side; right and left are the performer's own.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_SINGLE = ("tongueOut", "mouthRollLower", "mouthRollUpper")
_SIDED = ("cheekPuff", "mouthPress", "browInnerUp", "browDown", "noseSneer", "cheekSquint")
ACTIONS: tuple[str, ...] = (*_SINGLE, *(name + side for name in _SIDED for side in ("Right", "Left")))
"""Names of the actions."""
N_ACTIONS = len(ACTIONS)


def action_indices(names: Iterable[str]) -> NDArray[np.intp]:
    """Return the positions of actions in `ACTIONS`; ValueError for an unknown name."""
    return np.array([ACTIONS.index(name) for name in names], dtype=np.intp)


def _mirrored(name: str) -> str:
    if name.endswith("Right"):
        return name.removesuffix("Right") + "Left"
    return name.removesuffix("Left") + "Right" if name.endswith("Left") else name


ACTION_MIRROR: NDArray[np.intp] = action_indices(_mirrored(name) for name in ACTIONS)
"""Mirror image of each action: ``actions[ACTION_MIRROR]`` are the actions of a face that was flipped left to right."""
