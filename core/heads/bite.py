"""By how far the lower teeth of a head have to rise until the jaw is shut (method.md, section 4.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import UPPER_LIPS
from ..numeric.arrays import FloatArray
from .rig import HeadRig, Part
from .tongues import tongue_of

_BUILT_IN = 0.06
"""Angle in radians of the built-in heads, whose rigs have no teeth: 0.06 for the man's teeth, 0.062 for the woman's."""
_MIDDLE = 0.12
"""Distance from the middle, in outer-eye distances, within which teeth are front teeth."""
_FRONT = 0.06
"""Depth of the front teeth in outer-eye distances."""
_OVERLAP = 0.01
"""Overlap of shut teeth in outer-eye distances."""
_BELOW_LIP = 0.012
"""How far upper teeth reach below the inner rim of the upper lip at rest, in outer-eye distances: 0.009 on the built-in
man, 0.015 on the woman, 0.014 on an avatar."""
_WIDEST = 0.1
"""Largest distance, in outer-eye distances, by which they rise: the jaw of a head at rest is hardly open."""


def bite_of(rig: HeadRig) -> float:
    """Return the angle in radians by which the lower teeth of a head rise about the hinge of its jaw to meet the upper.

    It is 0 for a head whose teeth meet at rest, or that has no lower teeth. Upper teeth that are not in the rig, as a
    bone moves them, end below the upper lip.
    """
    if rig.parts is None or not np.isin((Part.TEETH_UPPER, Part.TEETH_LOWER), rig.kinds).any():
        return _BUILT_IN
    upper = rig.all_vertices[rig.kinds == Part.TEETH_UPPER]
    if not len(upper):
        upper = np.asarray(rig.vertices, dtype=np.float32)[rig.landmarks[UPPER_LIPS]]
        upper[:, 1] += _BELOW_LIP * rig.eye_distance
    lower = rig.all_vertices[(rig.kinds == Part.TEETH_LOWER) & ~tongue_of(rig)]
    return bite_between(upper, lower, np.asarray(rig.jaw_pivot, dtype=np.float64), rig.eye_distance)


def bite_between(upper: NDArray[np.float32], lower: NDArray[np.float32], hinge: FloatArray, unit: float) -> float:
    """Return the same for vertices (N, 3) and (M, 3) of both rows of teeth; `unit` is the outer-eye distance."""
    above, below = (_front_teeth(row.astype(np.float64), float(hinge[0]), unit) for row in (upper, lower))
    if not len(above) or not len(below):
        return 0.0
    gap = float(below[:, 1].min() - above[:, 1].max()) / unit
    reach = float(abs(below[:, 2].mean() - hinge[2])) / unit
    return min(max(gap + _OVERLAP, 0.0), _WIDEST) / reach


def _front_teeth(row: FloatArray, middle: float, unit: float) -> FloatArray:
    front = row[np.abs(row[:, 0] - middle) < _MIDDLE * unit]
    return np.asarray(front[front[:, 2] < front[:, 2].min() + _FRONT * unit]) if len(front) else front
