"""Settings of how a take drives a head and is baked."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..bake.bake_settings import BakeSettings
from ..drive.drive_settings import DriveSettings
from ..files.setting import setting
from ..tracking.tracker import TrackingSettings


@dataclass(frozen=True)
class PuppetSettings:
    """How a take drives a head.

    Attributes
    ----------
    drive : DriveSettings
        How the vertices move.
    smoothing : float
        Strength of `ResultSmoother`; 0 leaves the take unchanged.
    rotation, translation : bool
        Whether the head's rotation and location follow the performer's.
    neutral : float or None
        Start in seconds of the second in which the performer's face is neutral; None to detect it.
    tracking : TrackingSettings
        How faces are found in a video.
    bake : BakeSettings
        What the motion is baked to.
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
    rotation: bool = setting(True, "Head Rotation", "Rotate the head with the performer's")
    translation: bool = setting(False, "Head Location", "Move the head with the performer's")
    neutral: float | None = None
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    bake: BakeSettings = field(default_factory=BakeSettings)
