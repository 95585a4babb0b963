"""Calibrations and recordings that start after a countdown."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

from ..core.errors import messages
from ..core.live.worker import LiveWorker

COUNTDOWN = 3.0
"""Seconds between the request for a calibration, or by default for a recording, and its start."""
_TASKS = messages(
    {
        False: "Look straight at the camera, with a relaxed face and the mouth closed",
        True: "Close the eyes tightly, and open the mouth wide",
        None: "Get ready: the recording starts. Esc cancels",
    }
)
"""Instructions for the performer, by whether the range of eyes and mouth is calibrated; None is before a recording."""


class Calibration:
    """A calibration that has been requested; it starts after a countdown.

    Parameters
    ----------
    range_of : bool
        Calibrate the range of eyes and mouth rather than the neutral face.
    """

    def __init__(self, worker: LiveWorker, *, range_of: bool, countdown: float) -> None:
        self.range_of = range_of
        self._worker, self._at = worker, perf_counter() + countdown
        self._started = False
        worker.quality = None

    @property
    def task(self) -> str:
        """What the performer has to do."""
        return _TASKS[self.range_of]

    @property
    def left(self) -> float:
        """Seconds until it starts; 0 while it is running."""
        return 0.0 if self._started else max(0.0, self._at - perf_counter())

    def step(self) -> bool:
        """Start the calibration when it is due, and return whether it has ended."""
        if self._started:
            return not self._worker.calibrating
        if perf_counter() >= self._at:
            self._started = True
            self._worker.calibrate(range_of=self.range_of)
        return False


@dataclass(frozen=True)
class DelayedRecording:
    """A recording that has been requested.

    Attributes
    ----------
    at : float
        When it starts, seconds of `time.perf_counter`.
    scene, name : str
        As in `Recorder.start`.
    """

    at: float
    scene: str
    name: str

    @property
    def task(self) -> str:
        """What the performer has to do."""
        return _TASKS[None]

    @property
    def left(self) -> float:
        """Seconds until it starts."""
        return max(1e-3, self.at - perf_counter())

    @property
    def due(self) -> bool:
        """Whether it has to start."""
        return perf_counter() >= self.at
