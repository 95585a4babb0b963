"""How a performance moves a head."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi
from typing import Literal

from ..deform.head_deformer import INFORMED
from ..settings import Choice, setting

Mode = Literal["3d", "planar"]


@dataclass(frozen=True)
class PosingSettings:
    """What the pose of the head and of the eyes is multiplied by, and where it ends.

    Attributes
    ----------
    rotation_strength, location_strength, eyes_strength : float
        0 rests, 1 follows the performer.
    rotation_limit, eyes_limit : float
        Radians from rest, about whatever axis.
    location_limit : float
        From rest, in the avatar's outer-eye distances.
    """

    rotation_strength: float = setting(
        1.0, "Rotation", "Head rotation relative to the performer's", low=0.0, high=10.0, soft_high=2.0
    )
    rotation_limit: float = setting(
        pi, "Rotation Limit", "Largest turn of the head from rest", low=0.0, high=pi, unit="angle"
    )
    location_strength: float = setting(
        1.0, "Location", "Head motion relative to the performer's", low=0.0, high=10.0, soft_high=2.0
    )
    location_limit: float = setting(
        10.0, "Location Limit", "Largest move of the head from rest, in eye distances", low=0.0, high=10.0
    )
    eyes_strength: float = setting(
        1.0, "Eyes", "Eye rotation relative to the performer's", low=0.0, high=10.0, soft_high=2.0
    )
    eyes_limit: float = setting(
        pi / 6, "Eyes Limit", "Largest turn of the eyes from rest", low=0.0, high=pi / 2, unit="angle"
    )


@dataclass(frozen=True)
class DriveSettings:
    """How a performance moves the vertices of a head.

    Attributes
    ----------
    mode : {"3d", "planar"}
    kernel : str
        "informed" for `DEFAULT_KERNEL` with what is learnt of faces beside it, or a name of `kernels.KERNELS`; the
        paper's is "gaussian".
    strength_upper, strength_middle, strength_lower : float
        Gains of the regions.
    mirror : bool
        Whether the head is the performer's mirror image.
    incremental : bool
        Fit every frame again from the one before, as the paper does.
    posing : PosingSettings
        Strength and limits of head and eyes.
    """

    mode: Mode = setting(
        "3d",
        "Depth",
        "Where the depth of a motion comes from",
        choices=(
            Choice("3d", "3D", "Depth from the tracker's 3-D face"),
            Choice("planar", "Planar", "Every vertex keeps its depth"),
        ),
    )
    kernel: str = setting(
        INFORMED,
        "Skin",
        "How the skin between the landmarks follows them",
        choices=(
            Choice(INFORMED, "Informed", "By distance and by what moves together in known expressions"),
            Choice("multiscale", "Multiscale", "By distance, near and far"),
            Choice("gaussian", "Gaussian", "By one Gaussian of distance per region, as in the paper"),
            Choice("wendland", "Wendland", "By a smooth function of distance with compact support"),
            Choice("biharmonic", "Biharmonic", "By distance, like a thin plate"),
        ),
    )
    strength_upper: float = setting(
        1.0, "Brows and Upper Lids", "Strength of the motion of brows and upper lids", low=0.0, high=5.0, soft_high=2.0
    )
    strength_middle: float = setting(
        1.0, "Cheeks and Upper Lip", "Strength of the motion of cheeks and upper lip", low=0.0, high=5.0, soft_high=2.0
    )
    strength_lower: float = setting(
        1.0, "Lower Lip and Chin", "Strength of the motion of lower lip and chin", low=0.0, high=5.0, soft_high=2.0
    )
    mirror: bool = setting(False, "Mirror", "Move the head like the performer's mirror image")
    incremental: bool = False
    posing: PosingSettings = field(default_factory=PosingSettings)

    @property
    def strength(self) -> tuple[float, float, float]:
        """Gains of the regions upper, middle and lower."""
        return self.strength_upper, self.strength_middle, self.strength_lower
