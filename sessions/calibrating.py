"""Calibrations of a live session: those that are requested, and what it learns about the performer by itself."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

from ..blender.media.sounds import beep
from ..core.errors import HeadError
from ..core.live.worker import LiveWorker
from ..core.takes.neutral import Neutral
from ..settings.preferences import preferences
from .countdown import COUNTDOWN, Calibration

_KEEPING = 5.0
"""Seconds after which the learnt calibration is stored again: little is lost in a crash, and storing takes long."""


class Calibrating:
    """Calibrates the performer of a session.

    Parameters
    ----------
    on_calibrated : callable
        Called with the `Neutral` of each calibration that was requested.
    on_learnt : callable, optional
        Called from time to time with the `Neutral` learnt so far.

    Attributes
    ----------
    current : Calibration or None
        The calibration that has been requested, or is running.
    """

    def __init__(
        self,
        worker: LiveWorker,
        on_calibrated: Callable[[Neutral], object],
        on_learnt: Callable[[Neutral], object] | None,
    ) -> None:
        self.current: Calibration | None = None
        self._worker = worker
        self._on_calibrated, self._on_learnt = on_calibrated, on_learnt
        self._learnt: Neutral | None = None
        self._kept_at = perf_counter()

    def begin(self, *, range_of: bool = False, countdown: float = COUNTDOWN) -> None:
        """Calibrate after a countdown in seconds: the neutral face, or the range of eyes and mouth.

        Raises
        ------
        HeadError
            If the range is requested before there is a neutral face.
        """
        if range_of and self._worker.neutral is None:
            raise HeadError("There is no neutral face yet. Calibrate it first.")
        self.current = Calibration(self._worker, range_of=range_of, countdown=countdown)

    def step(self) -> None:
        """Continue the calibration, and store from time to time what was learnt, so that the next session has it."""
        if self.current is not None and self.current.step():
            self.current = None
            if self._worker.neutral is not None and self._worker.quality is not None:
                self._on_calibrated(self._worker.neutral)
            signal()
        if self._on_learnt is None or perf_counter() < self._kept_at + _KEEPING:
            return
        self._kept_at = perf_counter()
        if (learnt := self._worker.learnt) is not None and learnt is not self._learnt:
            self._learnt = learnt
            self._on_learnt(learnt)


def signal() -> None:
    """Signal to the performer that something has started or ended, unless the user has turned sounds off."""
    if preferences().sounds:
        beep()
