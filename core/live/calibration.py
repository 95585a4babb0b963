"""Live calibration: the neutral face, and how far eyes close and the mouth opens (method.md, section 4.1).

In a take, `calibrate` finds a neutral moment. Live, the performer is asked for one, and told how well it went.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import Message, SourceError
from ..numeric.arrays import FloatArray
from ..takes.face_space import load_face_space
from ..takes.neutral import Neutral, calibrate, shut_level, trust
from ..takes.take import TakeRecorder
from ..tracking.result import TrackResult

DURATION = 1.0
RANGE_DURATION = 4.0
_MIN_FRAMES = 5
"""Smallest number of frames with a face."""
_MAX_MOTION = 0.02
"""Standard deviation of landmarks, in outer-eye distances, above which the performer has moved."""
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
    """Collects results for about a second and averages them.

    Parameters
    ----------
    asked : bool
        Whether the performer was asked to rest. If not, expressions are removed from the face.
    duration : float
        Time in seconds from the first result with a face.
    """

    def __init__(self, *, asked: bool = True, duration: float = DURATION) -> None:
        self._asked, self._duration = asked, duration
        self._recorder = TakeRecorder({})
        self._since = 0.0

    def __len__(self) -> int:
        return len(self._recorder)

    def add(self, time: float, result: TrackResult) -> bool:
        """Add a result.

        Parameters
        ----------
        time : float
            Time in seconds.
        result : TrackResult
            Result at that time.
        """
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
    """Collects results for some seconds in which the performer shuts the eyes and opens the mouth wide.

    Parameters
    ----------
    neutral : Neutral
        The neutral face to extend.
    duration : float
        Time in seconds from the first result.
    """

    def __init__(self, neutral: Neutral, duration: float = RANGE_DURATION) -> None:
        self._neutral, self._duration = neutral, duration
        self._shapes: list[FloatArray] = []
        self._mouths: list[float] = []
        self._since: float | None = None

    def add(self, time: float, result: TrackResult) -> bool:
        """Add a result.

        Parameters
        ----------
        time, result
            As for `NeutralCalibration.add`.
        """
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
