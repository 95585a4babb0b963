"""The three regions of the face, cut through the eye slits and the mouth slit along muscle groups (METHOD section 6).

Lips that touch, and lids that touch, move apart: neighbours in space that hardly influence each other. One radial
basis function over the whole face halves the opening of mouth and eyes; one for each region does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..landmarks import (
    BROWS,
    EYE_CORNERS,
    JAW,
    LOWER_LIDS,
    LOWER_LIP,
    LOWER_LIPS,
    MOUTH_CORNERS,
    N_LANDMARKS,
    NOSE,
    NOSE_ROOT,
    UPPER_LIDS,
    UPPER_LIP,
    UPPER_LIPS,
)
from ..mesh.kernels import Kernel, distances

UPPER, MIDDLE, LOWER = 0, 1, 2

DEFAULT_KERNEL = "multiscale"
"""Kernel that heads are driven with; the paper's is "gaussian"."""


@dataclass(frozen=True)
class Region:
    """A region of the face.

    Attributes
    ----------
    name : str
    landmarks : (P,) intp
        The landmarks (positions in the 66) that control it.
    spacing_factor : float
        Width of its kernel over the spacing of its landmarks, as `RBFDeformer` takes it. By measurement: with these
        the vertex error on two heads of known expressions (`bench/deformation.py`) is about least. The upper one is
        small, as lids move close below brows that rest.
    """

    name: str
    landmarks: NDArray[np.intp]
    spacing_factor: float


_SHARED_ABOVE = np.concatenate([EYE_CORNERS, NOSE_ROOT])
"""By the upper and the middle region; the mouth's corners are by the middle and the lower one."""

REGIONS: tuple[Region, Region, Region] = (
    Region("upper", np.concatenate([BROWS, UPPER_LIDS, _SHARED_ABOVE]), 0.5),
    Region(
        "middle",
        np.concatenate(
            [np.sort(LOWER_LIDS), NOSE[2:], UPPER_LIP, UPPER_LIPS, JAW[:4], JAW[13:], _SHARED_ABOVE, MOUTH_CORNERS]
        ),
        0.8,
    ),
    Region("lower", np.concatenate([LOWER_LIP[::-1], LOWER_LIPS[::-1], JAW[4:13], MOUTH_CORNERS]), 0.85),
)


def membership() -> NDArray[np.bool_]:
    """(3, 66): which landmark controls which region; eye corners, nose bridge and mouth corners control two."""
    table = np.zeros((len(REGIONS), N_LANDMARKS), dtype=np.bool_)
    for row, region in zip(table, REGIONS, strict=True):
        row[region.landmarks] = True
    return table


def region_sigmas(landmarks: FloatArray, kernel: Kernel) -> FloatArray:
    """(3,) width of the kernel in each region of a head with (66, 3) `landmarks`, unit of these.

    From all landmarks of the region, whichever of them are control points: fewer points do not make the skin stiffer.
    """
    widths = [
        kernel.width(distances(points, points), region.spacing_factor)
        for region in REGIONS
        for points in [landmarks[region.landmarks]]
    ]
    return np.array(widths)


def spread(points: FloatArray) -> FloatArray:
    """Root mean square extent of points (N, 3) across and down, (2,)."""
    return np.asarray(points[:, :2].std(axis=0))
