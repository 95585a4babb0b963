"""Calibration before the camera: the performer at rest, and how far the eyes close and the mouth opens.

`retarget.calibrate` finds a neutral second in a take; live the performer is asked for it, and told how good it was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..errors import SourceError
from ..takes.neutral import Neutral, calibrate, shut_level
from ..takes.take import TakeRecorder
from ..tracking.result import TrackResult

DURATION = 1.0
RANGE_DURATION = 4.0
_FEWEST = 5
_STILL = 0.02
_TURNED = np.radians(20.0)


@dataclass(frozen=True)
class Quality:
    """What is to be said of a calibration: `good`, and one sentence on what to do better, or that it is well."""

    good: bool
    message: str


class NeutralCalibration:
    """Collects the results of about a second and averages them.

    Parameters
    ----------
    duration : float
        Seconds from the first result in which a face is found.
    """

    def __init__(self, duration: float = DURATION) -> None:
        self._duration = duration
        self._recorder = TakeRecorder({})
        self._since = 0.0

    def __len__(self) -> int:
        return len(self._recorder)

    def add(self, time: float, result: TrackResult) -> bool:
        """Take in the result at `time`, seconds; returns whether that is enough."""
        if len(self._recorder) == 0:
            self._since = time
        self._recorder.append(time, result)
        return time - self._since >= self._duration

    def neutral(self) -> Neutral:
        """The performer at rest; SourceError where no face was found."""
        take = self._recorder.finish()
        return calibrate(take, float(take.times[0]), self._duration + 1e-6)

    def quality(self) -> Quality:
        """How far the calibration is to be trusted."""
        take = self._recorder.finish()
        found = take.found
        if found.sum() < _FEWEST:
            return Quality(
                False, "Your face was hardly seen. Look at the camera, with light from the front, and repeat."
            )
        if found.mean() < 0.8:
            return Quality(False, "Your face was lost for a while. Stay in view and repeat.")
        shape = take.shape[found].astype(np.float64)
        if float(shape.std(axis=0).mean()) > _STILL:
            return Quality(False, "You moved. Hold a relaxed face for a second and repeat.")
        if float(np.abs(np.median(take.pose[found, 2], axis=0))) > _TURNED:
            return Quality(False, "Your head was turned. Look straight at the camera and repeat.")
        return Quality(True, "Neutral face taken.")


class RangeCalibration:
    """Collects some seconds in which the performer shuts the eyes and opens the mouth wide.

    Parameters
    ----------
    neutral : Neutral
        What is to learn of it.
    """

    def __init__(self, neutral: Neutral, duration: float = RANGE_DURATION) -> None:
        self._neutral, self._duration = neutral, duration
        self._shapes: list[FloatArray] = []
        self._mouths: list[float] = []
        self._since: float | None = None

    def add(self, time: float, result: TrackResult) -> bool:
        """Take in the result at `time`, seconds; returns whether that is enough."""
        self._since = time if self._since is None else self._since
        if result.found:
            self._shapes.append(result.shape)
            self._mouths.append(result.mouth_aperture)
        return time - self._since >= self._duration

    def neutral(self) -> Neutral:
        """The neutral that knows the range; SourceError where the face was hardly seen."""
        if len(self._shapes) < _FEWEST:
            raise SourceError("Your face was hardly seen. Look at the camera, with light from the front, and repeat.")
        widest = float(np.sort(self._mouths)[-min(3, len(self._mouths))])
        return replace(self._neutral, shut=shut_level(self._neutral.shape, np.array(self._shapes)), open_mouth=widest)

    def quality(self) -> Quality:
        """Whether shut eyes and an open mouth were seen."""
        if len(self._shapes) < _FEWEST:
            return Quality(
                False, "Your face was hardly seen. Look at the camera, with light from the front, and repeat."
            )
        learnt = self.neutral()
        if learnt.shut == 0.0:
            return Quality(False, "Shut eyes were not seen. Shut them for a second and repeat.")
        if learnt.mouth_gain == 1.0:
            return Quality(False, "Eyes taken; the mouth was hardly opened. Open it wide and repeat.")
        return Quality(True, "Shut eyes and open mouth taken.")
