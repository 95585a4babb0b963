"""Settings of how a performance moves a head."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi
from typing import Literal

from ..base.setting import Choice, setting
from .head_deformer import INFORMED

Mode = Literal["3d", "planar"]
Borders = Literal["soft", "sharp"]


@dataclass(frozen=True)
class PosingSettings:
    """Strength and limits of the pose of the head and the eyes.

    Attributes
    ----------
    rotation_strength, location_strength, eyes_strength : float
        Gains: 0 stays at rest, 1 follows the performer.
    rotation_limit, eyes_limit : float
        Largest angle from rest about any axis in radians.
    location_limit : float
        Largest distance from rest, in the avatar's outer-eye distances.
    """

    rotation_strength: float = setting(
        1.0, "Rotation", "Head rotation relative to the performer's", low=0.0, high=10.0, soft_high=2.0
    )
    rotation_limit: float = setting(
        pi, "Rotation Limit", "Largest rotation of the head from rest", low=0.0, high=pi, unit="angle"
    )
    location_strength: float = setting(
        1.0, "Location", "Head movement relative to the performer's", low=0.0, high=10.0, soft_high=2.0
    )
    location_limit: float = setting(
        10.0, "Location Limit", "Largest movement of the head from rest, in eye distances", low=0.0, high=10.0
    )
    eyes_strength: float = setting(
        1.0, "Eyes", "Eye rotation relative to the performer's", low=0.0, high=10.0, soft_high=2.0
    )
    eyes_limit: float = setting(
        pi / 6, "Eyes Limit", "Largest rotation of the eyes from rest", low=0.0, high=pi / 2, unit="angle"
    )


@dataclass(frozen=True)
class DriveSettings:
    """How a performance moves the vertices of a head.

    Attributes
    ----------
    mode : {"3d", "planar"}
        Source of the depth of the motion.
    kernel : str
        "informed" for `DEFAULT_KERNEL` combined with a covariance learnt from known expressions, or a key of
        `kernels.KERNELS`; the paper uses "gaussian".
    strength_upper, strength_middle, strength_lower : float
        Gains of the regions.
    mirror : bool
        Whether the head moves like the performer's mirror image.
    only_landmarks : bool
        Whether to ignore what no landmark shows, as in the paper.
    borders : {"soft", "sharp"}
        How regions meet: "sharp" is the paper's rule, with weights of 0 and 1 and the mean for vertices on a border.
    exact : bool
        Whether to fit without a ridge, as in the paper, so that each region meets its control points exactly.
    incremental : bool
        Whether to fit each frame to the coordinates of the previous one, as in the paper.
    contact : bool
        Whether to keep the lids outside the eyeballs, which the paper does not. Has no effect in mode "planar", where
        it would change depths.
    posing : PosingSettings
        Strength and limits of the pose of the head and the eyes.

    Examples
    --------
    >>> from facemime import DriveSettings, HeadDriver, built_in_head, calibrate, load_take
    >>> neutral = calibrate(load_take("performance.facetake"))
    >>> paper = DriveSettings(kernel="gaussian", borders="sharp", mode="planar")
    >>> HeadDriver(built_in_head(), neutral, paper).options.kernel
    'gaussian'
    """

    mode: Mode = setting(
        "3d",
        "Depth",
        "Where the depth of the motion comes from",
        choices=(
            Choice("3d", "3D", "Use the depth of the tracked 3D face"),
            Choice("planar", "Planar", "Keep the depth of every vertex"),
        ),
    )
    kernel: str = setting(
        INFORMED,
        "Skinning",
        "How the skin between the landmarks follows their motion",
        choices=(
            Choice(INFORMED, "Learned", "By distance, and by which parts of a face move together in known expressions"),
            Choice("multiscale", "Multiscale", "By distance, at a small and a large scale"),
            Choice("gaussian", "Gaussian", "By distance, with one Gaussian function per region as in the paper"),
            Choice("wendland", "Wendland", "By distance, with a smooth function of compact support"),
            Choice("biharmonic", "Biharmonic", "By distance, like a thin plate"),
        ),
    )
    strength_upper: float = setting(
        1.0,
        "Brows",
        "Strength of the motion of the brows and upper eyelids",
        low=0.0,
        high=5.0,
        soft_high=2.0,
    )
    strength_middle: float = setting(
        1.0,
        "Cheeks",
        "Strength of the motion of the lower eyelids, cheeks and upper lip",
        low=0.0,
        high=5.0,
        soft_high=2.0,
    )
    strength_lower: float = setting(
        1.0, "Jaw", "Strength of the motion of the lower lip and chin", low=0.0, high=5.0, soft_high=2.0
    )
    mirror: bool = setting(False, "Mirror", "Move the head like the performer's mirror image")
    only_landmarks: bool = setting(
        False,
        "Only Landmarks",
        "Ignore actions that no landmark shows: the tongue, puffed cheeks, pressed lips and a wrinkled nose",
    )
    borders: Borders = setting(
        "soft",
        "Borders",
        "How neighbouring regions meet",
        choices=(
            Choice("soft", "Soft", "Regions blend according to their painted weights"),
            Choice("sharp", "Sharp", "Each vertex belongs to one region, or to both on a border, as in the paper"),
        ),
    )
    exact: bool = setting(
        False, "Exact Fit", "Meet the landmarks exactly, as in the paper; the skin between them is less smooth"
    )
    incremental: bool = setting(
        False,
        "Refit Every Frame",
        "Fit each frame to the previous one, as in the paper; slower, and the face does not fully return to rest",
    )
    contact: bool = setting(
        True, "Lids on Eyeballs", "Let the eyelids slide over the eyeballs; has no effect if the depth is planar"
    )
    posing: PosingSettings = field(default_factory=PosingSettings)

    @property
    def strength(self) -> tuple[float, float, float]:
        """Gains of the upper, middle and lower regions."""
        return self.strength_upper, self.strength_middle, self.strength_lower
