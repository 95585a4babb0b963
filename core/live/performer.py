"""A performer in a live session: calibration, what is learnt about the face, and smoothing."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from ..errors import FacemimeError, Message
from ..takes.between import at_rest, between
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult
from ..tracking.smoothing import ResultSmoother
from .calibration import NeutralCalibration, Quality, RangeCalibration
from .learning import PerformerLearner
from .sources import LiveFrame

_RECENT = 900
"""Number of frames in `Performer.recent`: half a minute with most cameras."""


class Performer:
    """The current knowledge of a performer.

    Parameters
    ----------
    neutral : Neutral, optional
        The neutral face; by default the first second with a face is used.

    Attributes
    ----------
    neutral : Neutral or None
        The neutral face.
    quality : Quality or None
        Quality of the last calibration.
    result : TrackResult or None
        The newest result, smoothed.
    recent : deque of (float, TrackResult)
        Times in seconds and results of the last half minute.
    """

    def __init__(self, neutral: Neutral | None = None) -> None:
        self.neutral = neutral
        self.quality: Quality | None = None
        self.result: TrackResult | None = None
        self.recent: deque[tuple[float, TrackResult]] = deque(maxlen=_RECENT)
        self._calibration: NeutralCalibration | RangeCalibration | None = None
        self._stated: Neutral | None = None
        self._first = None if neutral is not None else NeutralCalibration(asked=False)
        self._learner: PerformerLearner | None = None
        self._forget = False
        self._smoother = ResultSmoother()

    @property
    def calibrating(self) -> bool:
        """Whether a requested calibration is in progress."""
        return self._calibration is not None

    @property
    def learnt(self) -> Neutral | None:
        """The neutral face, once enough has been learnt about the performer to keep it; otherwise None."""
        learner = self._learner
        return learner.neutral if learner is not None and learner.is_sure else None

    def calibrate(self, *, range_of: Neutral | None = None) -> None:
        """Use the next second as the neutral face, or the next seconds as the range of the neutral face `range_of`."""
        self.quality = None
        self._calibration = NeutralCalibration() if range_of is None else RangeCalibration(range_of)

    def forget(self) -> None:
        """Forget the neutral face. The next second with a face is used, and learning starts from scratch."""
        self._forget = True

    def change(self) -> None:
        """Start learning from scratch, as another face is tracked."""
        self._learner = None

    def add(self, frame: LiveFrame, seen: TrackResult, *, smoothing: float, learn: bool) -> TrackResult:
        """Add a frame.

        Parameters
        ----------
        seen : TrackResult
            Its result, as tracked.
        smoothing : float
            Amount for `ResultSmoother`; 0 disables smoothing.
        learn : bool
            Whether to learn from the frame.

        Returns
        -------
        TrackResult
            Result for display: returned to rest if the source has stopped, and smoothed.
        """
        self._adopt(frame.neutral)
        if not frame.filled:
            self.recent.append((frame.time, seen))
        self.result = result = self._smoothed(self._eased(seen, frame.rest), frame.time, smoothing)
        if not frame.filled:
            self._calibrate(frame.time, result)
            if learn and frame.rest <= 0.0:
                self._learn(frame.time, result)
        return result

    def _adopt(self, neutral: Neutral | None) -> None:
        """Use the neutral face stated by a source, once, so that it can be calibrated afterwards."""
        if neutral is not None and neutral is not self._stated:
            self._stated = self.neutral = neutral
        if self._forget and self._stated is None:
            self.neutral, self._first, self._learner = None, NeutralCalibration(asked=False), None
        self._forget = False

    def _eased(self, seen: TrackResult, rest: float) -> TrackResult:
        if rest <= 0.0 or not seen.found or self.neutral is None:
            return seen
        return between(seen, at_rest(self.neutral, seen), rest)

    def _smoothed(self, seen: TrackResult, time: float, amount: float) -> TrackResult:
        if amount <= 0.0:
            self._smoother.reset()
            return seen
        if amount != self._smoother.amount:
            self._smoother = ResultSmoother(amount)
        return self._smoother.smooth(seen, time)

    def _calibrate(self, time: float, result: TrackResult) -> None:
        """Feed the requested calibration or, without a neutral face, the initial one, from the first face on."""
        asked = self._calibration
        if asked is not None and asked.add(time, result):
            quality = asked.quality()
            try:
                measured = self._stated is not None
                self.neutral = replace(asked.neutral(), measured=measured)
            except FacemimeError as error:
                quality = Quality(False, Message(str(error)))
            self.quality = quality
            if self._calibration is asked:  # last, as the results are read as soon as it is done
                self._calibration = None
        if self.neutral is not None:
            self._first = None
        elif self._first is not None and (result.found or len(self._first)) and self._first.add(time, result):
            self.neutral, self._first = self._first.neutral(), None

    def _learn(self, time: float, result: TrackResult) -> None:
        """Learn from a frame. If a neutral face was calibrated meanwhile, learning restarts from it."""
        neutral = self.neutral
        if neutral is None or neutral.measured:
            return
        if self._learner is None or self._learner.neutral is not neutral:
            self._learner = PerformerLearner(neutral)
        self.neutral = self._learner.add(time, result)
