"""How a take moves a head, and what of it is kept."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..bake.settings import BakeSettings
from ..drive.settings import DriveSettings
from ..settings import setting


@dataclass(frozen=True)
class PuppetSettings:
    """How a take moves a head.

    Attributes
    ----------
    drive : DriveSettings
    smoothing : float
        As for `ResultSmoother`; 0 leaves the take as it is.
    rotation, translation : bool
        Whether the head's pose follows the performer's.
    neutral : float or None
        Seconds at which the performer's neutral second starts; None finds it.
    bake : BakeSettings
    """

    drive: DriveSettings = field(default_factory=DriveSettings)
    smoothing: float = setting(
        1.0,
        "Smoothing",
        "Jitter smoothing: 0 is off, values above 1 add lag",
        low=0.0,
        high=20.0,
        soft_high=3.0,
    )
    rotation: bool = setting(True, "Head Rotation", "Turn the head as the performer does")
    translation: bool = setting(False, "Head Location", "Move the head as the performer does")
    neutral: float | None = None
    bake: BakeSettings = field(default_factory=BakeSettings)
