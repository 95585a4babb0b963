"""Drivers of the heads of a live session, prepared again only where something has changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..drive.driver import HeadDriver, HeadFrame
from ..drive.settings import DriveSettings
from ..heads.rig import HeadRig
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult
from .key_driver import KeyDriver, LiveKeys


@dataclass(frozen=True, eq=False)
class LiveHead:
    """A head to drive.

    Attributes
    ----------
    rig : HeadRig
        If it is another object, the driver is prepared again.
    options : DriveSettings
        Its settings.
    prepare : callable
        Called in the thread with each `HeadFrame`, to prepare what would delay its display.
    keys : LiveKeys, optional
        Shape keys that drive its vertices instead of the landmarks.
    """

    rig: HeadRig
    options: DriveSettings = field(default_factory=DriveSettings)
    prepare: Callable[[HeadFrame], Any] = lambda frame: None
    keys: LiveKeys | None = None


class HeadDrivers:
    """Drivers of several heads, which may be exchanged from one frame to the next.

    Attributes
    ----------
    drivers : list of HeadDriver or KeyDriver
        Of the heads of the last frame.
    """

    def __init__(self) -> None:
        self.drivers: list[HeadDriver | KeyDriver] = []
        self._heads: tuple[LiveHead, ...] = ()
        self._neutral: Neutral | None = None

    def drive(
        self, heads: tuple[LiveHead, ...], neutral: Neutral | None, result: TrackResult
    ) -> tuple[tuple[HeadFrame, ...], tuple[Any, ...]]:
        """Return the frames of `heads`, and what `LiveHead.prepare` makes of each.

        Parameters
        ----------
        heads : tuple of LiveHead
            If this or `neutral` is another object than before, drivers are prepared; deformers of unchanged rigs are
            reused.
        neutral : Neutral or None
            The performer's neutral face; without one there are no frames.
        result : TrackResult
            Of the performer; without a face there are no frames.

        Returns
        -------
        frames : tuple of HeadFrame
        prepared : tuple
        """
        if neutral is None or not result.found:
            return (), ()
        if self._heads is not heads or self._neutral is not neutral:
            self._prepare(heads, neutral)
        frames = tuple(driver.frame(result) for driver in self.drivers)
        return frames, tuple(head.prepare(frame) for head, frame in zip(heads, frames, strict=True))

    def _prepare(self, heads: tuple[LiveHead, ...], neutral: Neutral) -> None:
        earlier = [driver.head if isinstance(driver, KeyDriver) else driver for driver in self.drivers]
        before = {id(driver.rig): driver for driver in earlier}
        drivers: list[HeadDriver | KeyDriver] = []
        for head in heads:
            driver = HeadDriver(head.rig, neutral, head.options, reuse=before.get(id(head.rig)))
            drivers.append(driver if head.keys is None else KeyDriver(driver, neutral, head.keys))
        self.drivers, self._heads, self._neutral = drivers, heads, neutral
