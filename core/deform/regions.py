"""The three regions of the face, cut through the eye slits and the mouth slit along muscle groups (METHOD section 6).

Lips that touch, and lids that touch, move apart: neighbours in space that hardly influence each other. One radial
basis function over the whole face halves the opening of mouth and eyes; one for each region does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..landmarks import N_LANDMARKS, from_ibug

UPPER, MIDDLE, LOWER = 0, 1, 2


@dataclass(frozen=True)
class Region:
    """A region of the face.

    Attributes
    ----------
    name : str
    landmarks : (P,) intp
        The landmarks (positions in the 66) that control it.
    spacing_factor : float
        Width of its Gaussians over the spacing of its landmarks, as `RBFDeformer` takes it. By measurement: with these
        the vertex error on the built-in head's 52 face units, alone and mixed, is about least. The upper one is small,
        as lids move close below brows that rest, and not smaller, as the rim between two of a lid's points would dent.
    """

    name: str
    landmarks: NDArray[np.intp]
    spacing_factor: float


_EYE_CORNERS_AND_BRIDGE = (36, 39, 42, 45, 27, 28)
_MOUTH_CORNERS = (48, 54)

REGIONS: tuple[Region, Region, Region] = (
    Region("upper", from_ibug([*range(17, 27), 37, 38, 43, 44, *_EYE_CORNERS_AND_BRIDGE]), 0.55),
    Region(
        "middle",
        from_ibug(
            [40, 41, 46, 47, *range(29, 36), *range(49, 54), *range(61, 64), *range(0, 4), *range(13, 17)]
            + [*_EYE_CORNERS_AND_BRIDGE, *_MOUTH_CORNERS]
        ),
        0.75,
    ),
    Region("lower", from_ibug([*range(55, 60), *range(65, 68), *range(4, 13), *_MOUTH_CORNERS]), 0.85),
)


def membership() -> NDArray[np.bool_]:
    """(3, 66): which landmark controls which region; eye corners, nose bridge and mouth corners control two."""
    table = np.zeros((len(REGIONS), N_LANDMARKS), dtype=np.bool_)
    for row, region in zip(table, REGIONS, strict=True):
        row[region.landmarks] = True
    return table
