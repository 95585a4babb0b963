"""Calibrations of a live session, and the countdown before them and before recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from ..core.errors import HeadError, messages
from ..core.puppet.worker import LiveWorker
from ..core.takes.neutral import Neutral
from ..settings.preferences import preferences

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
_PITCH = 880.0
"""Frequency of the tone, hertz."""
_LENGTH = 0.2
"""Length of the tone, seconds."""
_FADE = 0.05
"""Seconds in which it fades at the end."""
_VOLUME = 0.3
_KEEPING = 5.0
"""Seconds after which the learnt calibration is stored again: little is lost in a crash, and storing takes long."""


class Calibration:
    """A calibration that has been requested; it starts after a countdown.

    If `range_of` is set, it is of the range of eyes and mouth rather than the neutral face.
    """

    def __init__(self, worker: LiveWorker, *, range_of: bool, countdown: float) -> None:
        self.range_of = range_of
        self._worker, self._at = worker, perf_counter() + countdown
        self._started = False
        worker.first.quality = None

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
            return not self._worker.first.calibrating
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
    scene : int
        `session_uid` of the scene of `Recorder.start`.
    name : str
        As in `Recorder.start`.
    """

    at: float
    scene: int
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


class _Output:
    """The audio device, which is opened once, and the sound that is played."""

    device: Any = None
    playing: Any = None


def beep() -> bool:
    """Play a short tone, and return whether there is an audio device for it."""
    try:
        import aud
    except ImportError:  # Blender was built without it, as some of Debian's are
        return False
    try:
        _Output.device = _Output.device or aud.Device()
        tone = aud.Sound.sine(_PITCH).limit(0.0, _LENGTH).fadeout(_LENGTH - _FADE, _FADE).volume(_VOLUME)
        _Output.playing = _Output.device.play(tone)
    except aud.error:  # type: ignore[misc]  # it is an exception
        return False
    return True


class Calibrating:
    """Calibrates the performer of a session.

    `on_calibrated` is called with the `Neutral` of each calibration that was requested, and `on_learnt` from time to
    time with the one learnt so far. `current` is the calibration that has been requested, or is running, or None.
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

        Raises HeadError if the range is requested before there is a neutral face.
        """
        if range_of and self._worker.first.neutral is None:
            raise HeadError("There is no neutral face yet. Calibrate it first.")
        self.current = Calibration(self._worker, range_of=range_of, countdown=countdown)

    def step(self) -> None:
        """Continue the calibration, and store from time to time what was learnt, so that the next session has it."""
        if self.current is not None and self.current.step():
            self.current = None
            if self._worker.first.neutral is not None and self._worker.first.quality is not None:
                self._on_calibrated(self._worker.first.neutral)
            signal()
        if self._on_learnt is None or perf_counter() < self._kept_at + _KEEPING:
            return
        self._kept_at = perf_counter()
        if (learnt := self._worker.first.learnt) is not None and learnt is not self._learnt:
            self._learnt = learnt
            self._on_learnt(learnt)


def signal() -> None:
    """Signal to the performer that something has started or ended, unless the user has turned sounds off."""
    if preferences().sounds:
        beep()
