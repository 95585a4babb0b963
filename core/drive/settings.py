"""How a performance moves a head."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ..deform.head_deformer import INFORMED
from .posing import Posing

Mode = Literal["3d", "planar"]


@dataclass(frozen=True)
class DriveOptions:
    """How a performance moves a head.

    Attributes
    ----------
    mode : {"3d", "planar"}
    strength : tuple of float
        Gains of the regions upper, middle and lower.
    kernel : str
        "informed" for `DEFAULT_KERNEL` with what is learnt of faces beside it, or a name of `kernels.KERNELS`; the
        paper's is "gaussian".
    incremental : bool
        Fit every frame anew from the one before, as the paper does.
    mirror : bool
        Whether the head is the performer's mirror image.
    posing : Posing
        Strength and limits of head and eyes.
    """

    mode: Mode = "3d"
    strength: tuple[float, float, float] = (1.0, 1.0, 1.0)
    kernel: str = INFORMED
    incremental: bool = False
    mirror: bool = False
    posing: Posing = field(default_factory=Posing)
