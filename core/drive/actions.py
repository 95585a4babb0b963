"""How strongly an avatar shows the actions that no landmark does (docs/method.md, section 4.6)."""

from __future__ import annotations

import numpy as np

from ..actions import ACTIONS, N_ACTIONS, action_indices
from ..arrays import FloatArray
from ..landmarks import from_ibug

TONGUE = ACTIONS.index("tongueOut")
_BROWS = {
    "browInnerUpRight": (from_ibug((20, 21)), -0.06),
    "browInnerUpLeft": (from_ibug((22, 23)), -0.06),
    "browDownRight": (from_ibug((18, 19, 20, 21)), 0.05),
    "browDownLeft": (from_ibug((22, 23, 24, 25)), 0.05),
}
"""What landmarks say of the brows: those that move down (y) by that many eye distances for a full action."""
_BROW_ACTIONS = action_indices(_BROWS)
_FLOOR = np.full(N_ACTIONS, 0.15)
"""Activation above the one at rest up to which nothing is shown: the noise of a face that does nothing."""
_MOST_AT_REST, _MOST = 0.6, 1.2
_UPPER = action_indices(name for name in ACTIONS if name.startswith("brow"))
_MIDDLE = action_indices(name for name in ACTIONS if name.startswith(("nose", "cheekSquint")))


class ActionDriver:
    """Turns tracked activations into those of an avatar.

    Parameters
    ----------
    rest : (15,) float64
        `Neutral.actions`; NaN counts as 0.
    shape : (66, 3) float64
        `Neutral.shape`.
    strength : (3,) sequence of float
        Gains of the regions upper, middle and lower.
    """

    def __init__(
        self, rest: FloatArray, shape: FloatArray, strength: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        self._rest = np.clip(np.nan_to_num(rest), 0.0, _MOST_AT_REST)
        self._heights = _brow_heights(shape)
        self._from = self._rest + _FLOOR
        gains = np.full(N_ACTIONS, strength[2])
        gains[_UPPER], gains[_MIDDLE] = strength[0], strength[1]
        self._gain = gains / (1.0 - self._from)
        self._most = _MOST * gains

    def activations(self, actions: FloatArray, shape: FloatArray) -> FloatArray:
        """Activations of the avatar.

        Parameters
        ----------
        actions : (15,) float64
            `TrackResult.actions`.
        shape : (66, 3) float64
            `TrackResult.shape`.

        Returns
        -------
        (15,) float64
            0 at rest, about 1 for a full action; all 0 if `actions` is unknown.

        Notes
        -----
        Equation 4.5: ``min(max(a - a_0 - f, 0) / (1 - a_0 - f), 1.2)``, where a_0 is the activation at rest and f is
        the floor, 0.15. Of the brows, whose landmarks say something, too, ``a - a_0`` is the mean of both.
        """
        if not np.isfinite(actions).all():
            return np.zeros(N_ACTIONS)
        seen = actions.copy()
        moved = _brow_heights(shape) - self._heights
        seen[_BROW_ACTIONS] = 0.5 * (actions + self._rest)[_BROW_ACTIONS] + 0.5 * moved
        return np.asarray(np.minimum(np.maximum(seen - self._from, 0.0) * self._gain, self._most))


def _brow_heights(shape: FloatArray) -> FloatArray:
    """(4,) what the landmarks of a shape (66, 3) say of `_BROWS`, up to a constant."""
    return np.array([float(shape[rows, 1].mean()) / full for rows, full in _BROWS.values()])
