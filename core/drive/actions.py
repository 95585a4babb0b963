"""Actions that no landmark shows: the strength with which an avatar shows them (method.md, section 4.6), and the motion
of the skin under them (section 5.9).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..deform.expressions import transferred
from ..deform.rbf import RBFDeformer
from ..face.landmarks import from_ibug, outer_eye_distance
from ..face.names import ACTIONS, N_ACTIONS, action_indices
from ..heads.built_in import load_head
from ..heads.rig import HeadRig
from ..numeric.arrays import FloatArray

_BLEND = 0.1
"""Half width, in outer-eye distances, of the middle of the face, where the two sides of a unit overlap."""


def action_modes(rig: HeadRig, deformer: RBFDeformer) -> NDArray[np.float32]:
    """Compute the displacements (15, V, 3) that each action adds to those that follow from the landmarks.

    Equation 5.9: ``B_k = U_k - D(U_k)``, where U_k is the face unit of the built-in head, carried over to this head,
    and D(U_k) is the response of its deformer to the displacements of U_k at the landmarks. Landmarks therefore stay
    where they were tracked. Displacements are those at activation 1, in the head frame and the unit of the mesh; those
    of the tongue, which is not part of the skin, are 0.
    """
    modes = transferred(_units(), rig.vertices, rig.faces, rig.landmarks, rig.region_weights)
    for _ in range(2):  # twice, as the deformer meets its landmarks only approximately
        modes -= np.stack([deformer.deform(mode[rig.landmarks]) for mode in modes]) - deformer.rest
    return modes


def _units() -> FloatArray:
    """Displacements of the built-in head's skin, (15, B, 3); units for both sides are split into halves."""
    head = load_head()
    unit = outer_eye_distance(head.vertices[head.landmarks])
    left = np.clip(0.5 + 0.5 * head.vertices[:, 0] / (_BLEND * unit), 0.0, 1.0)
    shares = {"Left": left, "Right": 1.0 - left}
    motions = np.zeros((len(ACTIONS), len(head.vertices), 3))
    for motion, name in zip(motions, ACTIONS, strict=True):
        if name in head.unit_names:
            motion[...] = head.units[head.unit_names.index(name)]
        else:
            side = "Left" if name.endswith("Left") else "Right"
            motion[...] = shares[side][:, None] * head.units[head.unit_names.index(name.removesuffix(side))]
    return motions


TONGUE = ACTIONS.index("tongueOut")
_BROWS = {
    "browInnerUpRight": (from_ibug((20, 21)), -0.06),
    "browInnerUpLeft": (from_ibug((22, 23)), -0.06),
    "browDownRight": (from_ibug((18, 19, 20, 21)), 0.05),
    "browDownLeft": (from_ibug((22, 23, 24, 25)), 0.05),
}
"""Evidence of landmarks for actions of the brows: landmarks, and their motion down (y) in eye distances for a full
action."""
_BROW_ACTIONS = action_indices(_BROWS)
_RANGES = {
    **{"tongueOut": (0.7, 0.9), "mouthRollLower": (0.3, 0.75), "mouthRollUpper": (0.3, 0.75)},
    **{"cheekPuff": (0.45, 0.8), "mouthPress": (0.35, 0.7), "browInnerUp": (0.2, 0.75), "browDown": (0.2, 0.6)},
    **{"noseSneer": (0.2, 0.85), "cheekSquint": (0.3, 0.9)},
}
"""Activations above rest at which an action begins to be shown, and at which it is shown in full. Faces reach the first
without acting, for instance with a tongue that is visible behind the teeth. The second is below 1, as uncertain
networks are cautious."""
_MAX_AT_REST = 0.6
_MAX_ACTIVATION = np.array([0.6 if name.startswith("mouthRoll") else 1.0 for name in ACTIONS])
"""Largest activations that are shown. A lip that is rolled in further would let the teeth through the skin below it."""
_UPPER = action_indices(name for name in ACTIONS if name.startswith("brow"))
_MIDDLE = action_indices(name for name in ACTIONS if name.startswith(("nose", "cheekSquint")))


class ActionDriver:
    """Converts tracked activations to those of an avatar; `gains` (15,) are the gains of the actions' regions.

    `rest` (15,) are the activations at rest, `Neutral.actions`, of which NaN counts as 0, `shape` (66, 3) is
    `Neutral.shape`, and `strength` are the gains of the regions upper, middle and lower.
    """

    def __init__(
        self, rest: FloatArray, shape: FloatArray, strength: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        self._rest = np.clip(np.nan_to_num(rest), 0.0, _MAX_AT_REST)
        self._heights = _brow_heights(shape)
        self.gains = np.full(N_ACTIONS, strength[2])
        self.gains[_UPPER], self.gains[_MIDDLE] = strength[0], strength[1]
        ranges = [_RANGES[name.removesuffix("Right").removesuffix("Left")] for name in ACTIONS]
        self._begin, full = np.array(ranges).T
        self._range = full - self._begin

    def above_rest(self, actions: FloatArray, shape: FloatArray) -> FloatArray:
        """Return the activations above rest (..., 15), for actions and shapes as of a `TrackResult`; NaN if unknown.

        They are ``u = a - a_0``, where a_0 is the activation at rest. For the brows, which have landmarks, too, they
        are the mean of this and the evidence of the landmarks.
        """
        above = actions - self._rest
        moved = _brow_heights(shape) - self._heights
        above[..., _BROW_ACTIONS] = 0.5 * (above[..., _BROW_ACTIONS] + moved)
        return np.asarray(above)

    def activations(self, actions: FloatArray, shape: FloatArray) -> FloatArray:
        """Return the activations (..., 15) of the avatar, for actions and shapes as of a `TrackResult`; 0 if unknown.

        Equation 4.6: ``min(max(u - f, 0) / (c - f), 1)``, at most 0.6 for rolled lips, and times the strength of the
        region. u is `above_rest`, f is where an action begins to be shown, and c where it is shown in full.
        """
        shown = (self.above_rest(actions, shape) - self._begin) / self._range
        shown = np.clip(shown, 0.0, _MAX_ACTIVATION) * self.gains
        shown[~np.isfinite(actions).all(axis=-1)] = 0.0
        return np.asarray(shown)


def _brow_heights(shape: FloatArray) -> FloatArray:
    """Positions of the landmarks of shapes (..., 66, 3) that are evidence for `_BROWS`, up to a constant, (..., 4)."""
    heights = shape[..., 1]
    return np.array([heights.take(rows, axis=-1).mean(axis=-1) / full for rows, full in _BROWS.values()]).T
