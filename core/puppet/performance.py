"""A take that is ready to drive heads: smoothed, and with the performer's neutral face."""

from __future__ import annotations

from dataclasses import dataclass

from ..drive.drive_settings import DriveSettings
from ..drive.driver import HeadDriver
from ..heads.rig import HeadRig
from ..takes.neutral import Neutral, calibrate
from ..takes.smooth import smooth_take
from ..takes.take import Take
from .puppet_settings import PuppetSettings


@dataclass(frozen=True)
class Performance:
    """A prepared take, whether it is displayed, baked or written to a file.

    Attributes
    ----------
    take : Take
        The smoothed take.
    neutral : Neutral
        The performer's neutral face.
    settings : DriveSettings
        How the performance moves a head.
    """

    take: Take
    neutral: Neutral
    settings: DriveSettings

    @classmethod
    def of(cls, take: Take, settings: PuppetSettings) -> Performance:
        """Prepare the performance in a take.

        Parameters
        ----------
        settings : PuppetSettings
            Smoothing, neutral face and driving.

        Raises
        ------
        SourceError
            If the take has no face, or none in the neutral second of the settings.
        """
        take = smooth_take(take, settings.smoothing)
        return cls(take, calibrate(take, settings.neutral), settings.drive)

    def driver(self, rig: HeadRig, reuse: HeadDriver | None = None) -> HeadDriver:
        """Create the driver of a head for this performance; `reuse` as for `HeadDriver`."""
        return HeadDriver(rig, self.neutral, self.settings, reuse=reuse)
