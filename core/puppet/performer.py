"""Performers: of a take, which is ready to drive heads, and in a live session, with calibration, what is learnt about
the face, and smoothing.

In a take, `calibrate` finds a neutral moment. Live, the performer is asked for one, and told how well it went.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from ..drive.drive_settings import DriveSettings
from ..drive.driver import HeadDriver
from ..errors import FacemimeError, Message, SourceError
from ..heads.rig import HeadRig
from ..numeric.arrays import FloatArray
from ..takes.correction import solve_pins
from ..takes.face_space import load_face_space
from ..takes.learnt import Learnt, corrected_result
from ..takes.neutral import Neutral, calibrate
from ..takes.rest import shut_level, trust
from ..takes.smooth import smooth_take
from ..takes.take import Take, TakeRecorder
from ..takes.timing import at_rest, between
from ..tracking.result import TrackResult
from ..tracking.smoothing import ResultSmoother
from .learning import PerformerLearner
from .puppet_settings import PuppetSettings
from .sources import LiveFrame

DURATION = 1.0
RANGE_DURATION = 4.0
_MIN_FRAMES = 5
"""Smallest number of frames with a face."""
_MAX_MOTION = 0.02
"""Standard deviation of landmarks, in outer-eye distances, above which the performer has moved."""
_RECENT = 900
"""Number of frames in `Performer.recent`: half a minute with most cameras."""


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
        """Smooth a take and find its neutral face by the settings.

        Raises SourceError if the take has no face, or none in the neutral second of the settings.
        """
        if (calm := smooth_take(take, settings.smoothing)) is not take:
            take = solve_pins(calm)  # a lid that was pinned shut stays shut
        return cls(take, calibrate(take, settings.neutral), settings.drive)

    def driver(self, rig: HeadRig, reuse: HeadDriver | None = None) -> HeadDriver:
        """Create the driver of a head for this performance; `reuse` as for `HeadDriver`."""
        return HeadDriver(rig, self.neutral, self.settings, reuse=reuse)

    def landmark_motion(self, rig: HeadRig, count: int) -> FloatArray:
        """Displacements (N, 66, 3) of a head's landmarks in up to `count` frames with a face, evenly spaced."""
        driver, rest = self.driver(rig), rig.vertices[rig.landmarks]
        seen = np.flatnonzero(self.take.found)
        chosen = seen[np.unique(np.linspace(0, len(seen) - 1, count).astype(np.intp))]
        frames = [driver.frame(self.take.result(int(row))).vertices[rig.landmarks] for row in chosen]
        return np.asarray(np.array(frames, dtype=np.float64) - rest)


_MAX_YAW = np.radians(20.0)
"""Yaw in radians above which the head was turned."""
_MAX_EXPRESSION = 0.35
"""Amount of expression, in eye distances, above which the performer did not rest. On the labelled neutral faces of
`lab.bench.expressions` it is below 0.1, and up to 0.9 elsewhere; brows are left out, as their height at rest
differs."""
_HARDLY_SEEN = Message("Your face was hardly visible. Look at the camera, with light from the front, and try again.")


@dataclass(frozen=True)
class Quality:
    """Quality of a calibration: whether it is `good`, and a `message` that says so or what to do better."""

    good: bool
    message: Message


class NeutralCalibration:
    """Collects results for about a second, from the first one with a face, and averages them.

    If the performer was not asked to rest, expressions are removed from the face.
    """

    def __init__(self, *, asked: bool = True, duration: float = DURATION) -> None:
        self._asked, self._duration = asked, duration
        self._recorder = TakeRecorder({})
        self._since = 0.0

    def __len__(self) -> int:
        return len(self._recorder)

    def add(self, time: float, result: TrackResult) -> bool:
        """Add a result at a time in seconds, and return whether there are enough."""
        if len(self._recorder) == 0:
            self._since = time
        self._recorder.append(time, result)
        return time - self._since >= self._duration

    def neutral(self) -> Neutral:
        """Return the neutral face; SourceError if no face was found."""
        take = self._recorder.finish()
        return calibrate(take, float(take.times[0]), self._duration + 1e-6) if self._asked else calibrate(take)

    def quality(self) -> Quality:
        """Assess the calibration."""
        take = self._recorder.finish()
        found = take.found
        if found.sum() < _MIN_FRAMES:
            return Quality(False, _HARDLY_SEEN)
        if found.mean() < 0.8:
            return Quality(False, Message("Your face was lost for a while. Stay in view and try again."))
        shape = take.shape[found].astype(np.float64)
        if float(shape.std(axis=0).mean()) > _MAX_MOTION:
            return Quality(False, Message("You moved. Keep a relaxed face for a second and try again."))
        if float(np.abs(np.median(take.pose[found, 2], axis=0))) > _MAX_YAW:
            return Quality(False, Message("Your head was turned. Look straight at the camera and try again."))
        frames = np.flatnonzero(found)
        space = load_face_space()
        shown = np.median(space.explain(shape, trust(take, frames)), axis=0)
        if space.amount(np.where(space.of_brows, 0.0, shown)[None])[0] > _MAX_EXPRESSION:
            return Quality(False, Message("You showed an expression. Relax your face, close your mouth and try again."))
        return Quality(True, Message("Neutral face set."))


class RangeCalibration:
    """Extends a neutral face by what is seen while the performer shuts the eyes and opens the mouth wide.

    It lasts `duration` seconds from the first result.
    """

    def __init__(self, neutral: Neutral, duration: float = RANGE_DURATION) -> None:
        self._neutral, self._duration = neutral, duration
        self._shapes: list[FloatArray] = []
        self._mouths: list[float] = []
        self._since: float | None = None

    def add(self, time: float, result: TrackResult) -> bool:
        """Add a result at a time in seconds, and return whether there are enough."""
        self._since = time if self._since is None else self._since
        if result.found:
            self._shapes.append(result.shape)
            self._mouths.append(result.mouth_aperture)
        return time - self._since >= self._duration

    def neutral(self) -> Neutral:
        """Return the neutral face with the range; SourceError if the face was hardly seen."""
        if len(self._shapes) < _MIN_FRAMES:
            raise SourceError(_HARDLY_SEEN)
        widest = float(np.sort(self._mouths)[-min(3, len(self._mouths))])
        return replace(self._neutral, shut=shut_level(self._neutral.shape, np.array(self._shapes)), open_mouth=widest)

    def quality(self) -> Quality:
        """Assess whether shut eyes and an open mouth were seen."""
        if len(self._shapes) < _MIN_FRAMES:
            return Quality(False, _HARDLY_SEEN)
        learnt = self.neutral()
        if learnt.shut == 0.0:
            return Quality(False, Message("No closed eyes seen. Close them for a second and try again."))
        if learnt.mouth_gain == 1.0:
            return Quality(False, Message("Your mouth was hardly opened. Open it wide and try again."))
        return Quality(True, Message("Shut eyes and open mouth set."))


class Performer:
    """The current knowledge of a performer, whose neutral face is by default found in the first second with a face.

    Attributes
    ----------
    quality : Quality or None
        Quality of the last calibration.
    result : TrackResult or None
        The newest result, smoothed.
    recent : deque of (float, TrackResult)
        Times in seconds and results of the last half minute, as tracked.
    corrections : tuple of Learnt
        What pins have told about the performer, by which results are corrected.
    """

    def __init__(self, neutral: Neutral | None = None) -> None:
        self.neutral = neutral
        self.quality: Quality | None = None
        self.result: TrackResult | None = None
        self.recent: deque[tuple[float, TrackResult]] = deque(maxlen=_RECENT)
        self.corrections: tuple[Learnt, ...] = ()
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
        """Add a frame and its result, as tracked, and return the one to display.

        It is corrected, returned to rest if the source has stopped, and smoothed by the amount for `ResultSmoother`, 0
        for none.
        `learn` is whether to learn from the frame.
        """
        self._adopt(frame.neutral)
        if not frame.filled:
            self.recent.append((frame.time, seen))
        eased = self._eased(corrected_result(seen, self.corrections), frame.rest)
        self.result = result = self._smoothed(eased, frame.time, smoothing)
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
