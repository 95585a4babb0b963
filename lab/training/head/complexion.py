"""Appearance of a head: the colours of its skin, lips, hair and eyes, and where its hair grows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Colour = tuple[float, float, float]
"""RGB, 0 to 1."""


@dataclass(frozen=True)
class Complexion:
    """Possible differences between two heads of the same shape.

    Attributes
    ----------
    tone, blood, bright : Colour
        Of the skin, of where it is red, and of the forehead.
    lip, lip_dark : Colour
        Of the lips, and of the line where they meet.
    hair : Colour
    iris_edge, iris, iris_inner : Colour
    beard : float
        How much of a shaved beard shows, 0 to 1.
    brow : float
        Width of the brows, relative to the man's.
    lashes : float
        Width of the line of the upper lashes, relative to the man's.
    hairline : (K, 2) array
        Degrees round from the front, and height of the hair's edge in the head frame, metres.
    hair_lift : float
        Metres by which hair lifts the scalp.
    hair_edge : (float, float)
        Distances inside the hairline, metres, between which hair becomes dense.
    comb : (float, float, float)
        How finely strands are spaced along x, y and z: they run where they are coarse.
    """

    tone: Colour
    blood: Colour
    bright: Colour
    lip: Colour
    lip_dark: Colour
    hair: Colour
    iris_edge: Colour
    iris: Colour
    iris_inner: Colour
    beard: float
    brow: float
    lashes: float
    hairline: NDArray[np.float64]
    hair_lift: float
    hair_edge: tuple[float, float]
    comb: tuple[float, float, float]


MAN = Complexion(
    tone=(0.845, 0.655, 0.555),
    blood=(0.800, 0.475, 0.420),
    bright=(0.890, 0.725, 0.615),
    lip=(0.735, 0.435, 0.395),
    lip_dark=(0.460, 0.215, 0.205),
    hair=(0.170, 0.120, 0.095),
    iris_edge=(0.085, 0.070, 0.055),
    iris=(0.300, 0.215, 0.125),
    iris_inner=(0.460, 0.320, 0.150),
    beard=1.0,
    brow=1.0,
    lashes=1.0,
    hairline=np.array(
        [
            *((0, -0.0745), (16, -0.0755), (32, -0.0690), (42, -0.0640), (50, -0.0500), (56, -0.0330), (62, -0.0220)),
            *((68, -0.0110), (72, 0.0000), (76, 0.0120), (84, 0.0140), (89, -0.0060), (104, -0.0180), (116, -0.0060)),
            *((126, 0.0230), (150, 0.0420), (180, 0.0480)),
        ]
    ),
    hair_lift=0.0015,
    hair_edge=(-0.0035, 0.0130),
    comb=(1.0, 0.22, 0.40),
)

WOMAN = Complexion(
    tone=(0.880, 0.705, 0.610),
    blood=(0.835, 0.500, 0.450),
    bright=(0.915, 0.770, 0.675),
    lip=(0.745, 0.410, 0.385),
    lip_dark=(0.470, 0.190, 0.195),
    hair=(0.235, 0.130, 0.075),
    iris_edge=(0.060, 0.080, 0.075),
    iris=(0.250, 0.300, 0.230),
    iris_inner=(0.420, 0.400, 0.230),
    beard=0.0,
    brow=0.72,
    lashes=1.5,
    hairline=np.array(
        [
            *((0, -0.0640), (16, -0.0650), (32, -0.0600), (42, -0.0520), (50, -0.0420), (56, -0.0330), (62, -0.0250)),
            *((68, -0.0170), (72, -0.0100), (76, -0.0060), (84, -0.0060), (89, -0.0110), (104, -0.0190)),
            *((116, -0.0060), (126, 0.0260), (150, 0.0500), (180, 0.0580)),
        ]
    ),
    hair_lift=0.0030,
    hair_edge=(-0.0005, 0.0110),
    comb=(1.0, 0.14, 0.10),
)
