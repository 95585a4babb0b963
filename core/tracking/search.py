"""Finding all faces of an image, whoever they are (docs/method.md, section 3.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .detect import EFFORTS, BoxDetector, Effort, Step
from .fitter import COARSE, REFINED, FaceFitter, Fit
from .model_file import TrackerModel
from .pdm import FittedShape

_MAX_BOXES, _MAX_FACES = 60, 4
"""Boxes per effort that are fitted coarsely, and those of them that are fitted to the end."""
_MAX_GRADUAL = 6
"""Boxes per step of a gradual search that are fitted coarsely."""
_CERTAIN = 0.85
"""Confidence of a detected face above which no further effort is made."""
_SEPARATION = 0.6
"""Eye distances between the centres of two fits above which they belong to two people."""
_ALL = tuple(Step.whole(effort) for effort in EFFORTS)
_QUICK = _ALL[:2]
"""The efforts that search for other people in view."""
_EVERY_FRAME = _ALL[:3]
"""The efforts that are made in every frame without a face, in addition to one of the others in turn."""
_IN_TURN = tuple(
    step
    for i, part in enumerate(part for effort in EFFORTS[len(_EVERY_FRAME) :] for part in Step.parts(effort))
    for step in ([Step.whole(Effort.SMALL), part] if i % 3 == 0 else [part])
)
"""The steps of which a gradual search makes one in each frame, beside those for near faces and for close-ups. Small
faces, which are common, come often."""
STAGES = ("detect", "experts", "fit", "check", "gaze", "actions")


@dataclass(frozen=True)
class Candidate:
    """A fitted face, and the confidence, 0 to 1, that it is a face."""

    fit: Fit
    confidence: float

    @property
    def pose(self) -> FloatArray:
        """(6,) pose, image frame."""
        return self.fit.fitted.pose

    def distance(self, x: float, y: float) -> float:
        """Distance from a point to the middle of the face.

        Parameters
        ----------
        x, y : float
            Pixels, image frame.

        Returns
        -------
        float
            Pixels.
        """
        return float(np.hypot(self.pose[4] - x, self.pose[5] - y))


class FaceSearch:
    """Finds faces in a grey image, from scratch or near a face of the previous frame.

    Parameters
    ----------
    model : TrackerModel

    Attributes
    ----------
    gradual : bool
        Whether the search spreads over many frames, so that none takes long.
    timings : dict of str to float
        Seconds that each stage has taken since `begin`: "detect", "experts", "fit", "check", "gaze", "actions".
    """

    found_above = 0.5
    """Confidence from which on a detected face counts."""

    def __init__(self, model: TrackerModel) -> None:
        self.gradual = False
        self._model = model
        self._detector = BoxDetector()
        self.timings: dict[str, float] = dict.fromkeys(STAGES, 0.0)
        self.fitter = FaceFitter(model, self.timings)

    def begin(self) -> None:
        """Reset the timings for another image."""
        self.timings.update(dict.fromkeys(STAGES, 0.0))

    def follow(self, grey: NDArray[np.uint8], last: FittedShape) -> Candidate:
        """Fit the face near its position in the previous frame, and judge the fit.

        Parameters
        ----------
        grey, last
            As for `FaceFitter.follow`.

        Returns
        -------
        Candidate
            Whatever its confidence is.
        """
        return self._judge(self.fitter.follow(grey, last))

    def steps(self, misses: int) -> tuple[Step, ...]:
        """What to do after `misses` frames without a face: all at first, then what is quick, and one more in turn.

        A gradual search does not begin with all, and what it does in turn is short.
        """
        if self.gradual:
            near, _, filling = _EVERY_FRAME
            return near, _IN_TURN[misses % len(_IN_TURN)], filling
        others = _ALL[len(_EVERY_FRAME) :]
        return _ALL if misses == 0 else (*_EVERY_FRAME, others[misses % len(others)])

    def detect(self, grey: NDArray[np.uint8], steps: Sequence[Step] = _ALL, *, small: bool = False) -> list[Candidate]:
        """Detect faces, step by step, until one of these finds a certain one.

        Parameters
        ----------
        grey : (H, W) uint8
            Grey image.
        steps : sequence of Step
            In order.
        small : bool
            Search small faces even if the first effort finds a certain one, as a particular face is awaited that
            may be small.

        Returns
        -------
        list of Candidate
            The accepted faces.
        """
        return list(self._detected(grey, steps, small))

    def others(self, grey: NDArray[np.uint8], pose: FloatArray, *, small: bool = False) -> list[Candidate]:
        """Find faces other than the one at `pose`; only boxes beside it are fitted.

        Parameters
        ----------
        grey : (H, W) uint8
            Grey image.
        pose : (6,) float64
            Pose of the tracked face, image frame.
        small : bool
            Search small faces, too, which takes longer.

        Returns
        -------
        list of Candidate
            The accepted faces.
        """

        def apart(other: FloatArray) -> bool:
            return float(np.hypot(*(other[4:6] - pose[4:6]))) > _SEPARATION * float(pose[0])

        steps = _QUICK if small else _QUICK[:1]
        starts = [[start for start in self._starts(grey, step) if apart(start)] for step in steps]
        return [c for poses in starts for c in self._faces_in(grey, poses) if apart(c.pose)]

    def _detected(self, grey: NDArray[np.uint8], steps: Sequence[Step], small: bool) -> Iterator[Candidate]:
        for step in steps:
            found = self._faces_in(grey, self._starts(grey, step))
            yield from found
            certain = any(c.confidence >= _CERTAIN for c in found)
            if certain and not (step.effort == Effort.NEAR and small):
                return

    def _starts(self, grey: NDArray[np.uint8], step: Step) -> list[FloatArray]:
        """Frontal poses (6,) of the boxes that the detector finds."""
        began = perf_counter()
        boxes = self._detector.boxes(grey, step)[: _MAX_GRADUAL if self.gradual else _MAX_BOXES]
        self.timings["detect"] += perf_counter() - began
        return [box.start_pose(self._model.box_offset) for box in boxes]

    def _faces_in(self, grey: NDArray[np.uint8], poses: Sequence[FloatArray]) -> list[Candidate]:
        """The accepted faces near the given poses (6,)."""
        tried = [self._judge(self.fitter.fit(grey, start, REFINED)) for start in self._promising(grey, poses)]
        return [c for c in tried if c.confidence >= self.found_above]

    def _promising(self, grey: NDArray[np.uint8], poses: Sequence[FloatArray]) -> list[FittedShape]:
        """The coarse fits from the given poses (6,) to which the face network gives the highest log odds."""
        neutral = np.zeros(self._model.pdm.n_modes)
        fits = [self.fitter.fit(grey, FittedShape(pose, neutral), (COARSE,)) for pose in poses]
        fits.sort(key=lambda f: -f.features[1])
        return [f.fitted for f in fits[:_MAX_FACES]]

    def _judge(self, fit: Fit) -> Candidate:
        return Candidate(fit, self._model.check.confidence(fit.features))


def largest(candidates: Sequence[Candidate]) -> Candidate | None:
    """The largest face; of fits of about the same size, which may be of one face, the most confident one."""
    certain = [c for c in candidates if c.confidence >= _CERTAIN] or candidates
    if not certain:
        return None
    size = max(c.pose[0] for c in certain)
    return max((c for c in certain if c.pose[0] > 0.8 * size), key=lambda c: c.confidence)
