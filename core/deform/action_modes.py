"""Motion of the skin under actions that no landmark shows (method.md, section 5.9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face.actions import ACTIONS
from ..face.landmarks import outer_eye_distance
from ..heads.built_in import load_head
from ..heads.rig import HeadRig
from ..numeric.arrays import FloatArray
from .expressions import transferred
from .rbf import RBFDeformer

_BLEND = 0.1
"""Half width, in outer-eye distances, of the middle of the face, where the two sides of a unit overlap."""


def action_modes(rig: HeadRig, deformer: RBFDeformer) -> NDArray[np.float32]:
    """Compute the displacements that each action adds to those that follow from the landmarks.

    Parameters
    ----------
    deformer : RBFDeformer
        The deformer of that head.

    Returns
    -------
    (15, V, 3) float32
        Displacements at activation 1, in the head frame and the unit of the mesh. Those of the tongue, which is not
        part of the skin, are 0.

    Notes
    -----
    Equation 5.9: ``B_k = U_k - D(U_k)``, where U_k is the face unit of the built-in head, carried over to this head,
    and D(U_k) is the response of the deformer to its displacements at the landmarks. Landmarks therefore stay where
    they were tracked.
    """
    modes = transferred(_units(), rig.vertices, rig.landmarks, rig.region_weights)
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
