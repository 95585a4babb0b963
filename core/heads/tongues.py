"""The tongue of a head: which of the parts within its mouth it is, and how it is stuck out (method.md, section 9.6) or
lies low.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import LIPS, LOWER_LIPS, UPPER_LIPS
from ..mesh.surface import islands
from ..numeric.arrays import FloatArray
from .rig import HeadRig, Part

_LENGTH = 0.25
"""Least length of a tongue in outer-eye distances; a tooth is shorter."""
_WIDTH = 0.15
"""Least width of a tongue in outer-eye distances; a tooth is narrower."""
_MIDDLE = 0.4
"""Share of the width, about the middle, that is searched for vertices in the rear half. It is empty in rows of teeth
and gums."""
_FILLED = 0.1
"""Share of the rear half's vertices that a tongue has there: on twelve heads of nine makers 0.17 to 0.46, rows of teeth
0."""
_REACH = 0.2
"""Distance in outer-eye distances from the foremost lip to the tip of a tongue that is out."""
_BELOW = 0.01
"""Height of the tongue below the slit of the mouth, in outer-eye distances, where it leaves the lips."""
_HANG = 0.1
"""Height by which its tip hangs below that, so that it is seen from the front."""
_DROOP, _TAPER = 0.05, 0.35
"""Height of its middle above a straight line, in outer-eye distances, and share of its width that the tip loses."""

_FLATTER = 0.5
"""Share of its thickness by which a tongue that fills the mouth is flattened. This and the next two were chosen by
looking at Jane, FaceGen's head, with an open, a wide and a round mouth."""
_TIP_DOWN = 0.02
"""Distance in outer-eye distances by which its tip is lowered as well."""
_ROOT_DOWN = 0.28
"""Distance by which its root is, which rises in front of the throat as the jaw turns down."""


def tongue_of(rig: HeadRig) -> NDArray[np.bool_]:
    """Return which of all vertices are the tongue's, (A,): a piece of the lower teeth that fills their arch."""
    vertices, unit = np.asarray(rig.all_vertices, dtype=np.float64), rig.eye_distance
    found = np.zeros(len(vertices), dtype=bool)
    if rig.parts is None:
        return found
    piece = islands(len(vertices), rig.all_faces)
    for number in np.unique(piece[rig.kinds == Part.TEETH_LOWER]):
        rows = (piece == number) & (rig.kinds == Part.TEETH_LOWER)
        if fills_arch(vertices[rows], unit):
            found |= rows
    return found


def fills_arch(vertices: FloatArray, unit: float) -> bool:
    """Return whether vertices (N, 3) in a mouth, head frame, fill an arch as a tongue does, unlike teeth and gums.

    `unit` is the outer-eye distance. A palate fills its arch, too.
    """
    x, _, z = np.asarray(vertices, dtype=np.float64).T
    width = float(np.ptp(x))
    rear = x[z > 0.5 * (z.min() + z.max())]
    if np.ptp(z) < _LENGTH * unit or width < _WIDTH * unit or not len(rear):
        return False
    return bool((np.abs(rear - 0.5 * (x.min() + x.max())) < 0.5 * _MIDDLE * width).mean() > _FILLED)


def tongue_out(rig: HeadRig, tongue: NDArray[np.bool_]) -> FloatArray:
    """Return the displacements (n, 3) of the `tongue`'s vertices when it is out: head frame, unit of the mesh."""
    unit, points = rig.eye_distance, np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    vertices = np.asarray(rig.all_vertices, dtype=np.float64)[tongue]
    x, y, z = vertices.T
    # From the root, 0, to the tip, 1.
    along = (z.max() - z) / np.ptp(z)
    slit = points[np.concatenate([UPPER_LIPS, LOWER_LIPS]), 1].mean()
    rise = y[along.argmax()] - (slit + _BELOW * unit)
    lips = points[LIPS, 2].min()
    forward = (z.min() - (lips - _REACH * unit)) * along**1.5
    outside = np.maximum(lips - (z - forward), 0.0) / (_REACH * unit)
    middle = 0.5 * (x.min() + x.max())
    return np.column_stack(
        [
            -_TAPER * (x - middle) * along**6,
            _DROOP * unit * along**4 - (rise + _DROOP * unit) * along + _HANG * unit * outside**2,
            -forward,
        ]
    )


def tongue_lowered(rig: HeadRig, tongue: NDArray[np.bool_]) -> FloatArray:
    """Return the displacements (n, 3) of the `tongue`'s vertices to the floor of the mouth, as `tongue_out` does.

    A tongue that fills the mouth at rest hides the darkness behind it, and the upper teeth, when the mouth opens.
    """
    _, heights, depths = np.asarray(rig.all_vertices, dtype=np.float64)[tongue].T
    back = (depths - depths.min()) / np.ptp(depths)
    down = _FLATTER * (heights.max() - heights) + (_TIP_DOWN + (_ROOT_DOWN - _TIP_DOWN) * back) * rig.eye_distance
    return np.asarray(down[:, None] * (0.0, 1.0, 0.0))
