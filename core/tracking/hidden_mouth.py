"""Lips that are hidden keep their last shape (method.md, section 3.6)."""

from __future__ import annotations

import numpy as np

from ..face.landmarks import LIPS
from ..numeric.arrays import FloatArray

_KNOWN = 0.6
"""Smallest mean certainty of the lips with which they are remembered."""
_SEEN = 0.5
"""Mean certainty of the lips below which they are partly held. In strangers' clips a mouth with the tongue out, a beard
or a scream has 0.53 or more, one behind a hand 0.2 to 0.5."""
_HIDDEN = 0.4
"""Mean certainty of the lips below which they are held completely."""


def seen_lips(certainty: FloatArray) -> float:
    """Return the mean certainty of the lips, 0 to 1, for `certainty` (66,) of each landmark."""
    return float(certainty[LIPS].mean())


def is_hidden(certainty: FloatArray) -> bool:
    """Return whether the lips are held, for `certainty` (66,) of each landmark; False if it is unknown."""
    return seen_lips(certainty) < _SEEN


class HiddenMouth:
    """Holds the lips while something covers them, which the experts would take for a gaping mouth."""

    def __init__(self) -> None:
        self._lips: FloatArray | None = None

    def reset(self) -> None:
        """Forget the lips, as another face follows."""
        self._lips = None

    def hold(self, shape: FloatArray, certainty: FloatArray) -> FloatArray:
        """Return a shape whose lips are replaced by the last well-seen ones, by as much as they are hidden.

        Parameters
        ----------
        shape : (66, 3) float64
            Fitted shape: head frame, outer-eye distances.
        certainty : (66,) float64
            Certainty of each landmark, 0 to 1.

        Returns
        -------
        (66, 3) float64
            The shape; `shape` itself if the mouth is seen.
        """
        seen = seen_lips(certainty)
        if seen >= _KNOWN:
            self._lips = shape[LIPS]
        # From 0 where the lips are just seen to 1 where they are hidden, so that nothing jumps.
        share = min((_SEEN - seen) / (_SEEN - _HIDDEN), 1.0)
        if share <= 0.0 or self._lips is None:
            return shape
        held = shape.copy()
        held[LIPS] += share * (self._lips - shape[LIPS])
        return np.asarray(held)
