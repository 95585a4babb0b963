"""A take made ready to move heads: smoothed, and measured from the performer's neutral face."""

from __future__ import annotations

from dataclasses import dataclass

from ..drive.driver import HeadDriver
from ..drive.settings import DriveSettings
from ..heads.rig import HeadRig
from ..takes.neutral import Neutral, calibrate
from ..takes.smooth import smooth_take
from ..takes.take import Take
from .settings import PuppetSettings


@dataclass(frozen=True)
class Performance:
    """What moves any head: the same whether it is shown, baked or written to a file."""

    take: Take
    neutral: Neutral
    settings: DriveSettings

    @classmethod
    def of(cls, take: Take, settings: PuppetSettings) -> Performance:
        """The performance in `take`.

        Raises
        ------
        SourceError
            Where the take holds no face, or none in the neutral second that `settings` names.
        """
        take = smooth_take(take, settings.smoothing)
        return cls(take, calibrate(take, settings.neutral), settings.drive)

    def driver(self, rig: HeadRig) -> HeadDriver:
        """What turns its frames into frames of a head."""
        return HeadDriver(rig, self.neutral, self.settings)
