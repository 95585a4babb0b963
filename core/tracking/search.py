"""The search: every convincing face of an image, whoever it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .detect import EFFORTS, BoxDetector, Effort
from .fitter import COARSE, REFINED, FaceFitter, Fit
from .model_file import TrackerModel
from .pdm import FittedShape

_MOST_BOXES, _MOST_FACES = 60, 4
"""How many boxes of an effort are looked at, and how many of them are fitted to the end."""
_BEYOND_DOUBT = 0.85
"""Confidence of a detected face from which on no further effort is made."""
_APART = 0.6
"""Eye distances between the centres of two fits from which on they are two people's."""
_QUICK = (Effort.NEAR, Effort.SMALL)
"""The efforts that look for others in view."""
_EVERY_FRAME = (*_QUICK, Effort.FILLING)
"""Those that are made in every frame while nobody is in view, beside one of the others in turn."""
STAGES = ("detect", "look", "fit", "check", "gaze")


@dataclass(frozen=True)
class Candidate:
    """A fitted face and the confidence, 0 to 1, that it is one."""

    fit: Fit
    confidence: float

    @property
    def pose(self) -> FloatArray:
        """(6,) as `FittedShape` has it."""
        return self.fit.fitted.pose

    def distance(self, x: float, y: float) -> float:
        """From the place (x, y), pixels, to the middle of the face."""
        return float(np.hypot(self.pose[4] - x, self.pose[5] - y))


class FaceSearch:
    """Finds faces in a grey image, from scratch or from where one was a frame ago.

    Parameters
    ----------
    model : TrackerModel

    Attributes
    ----------
    timings : dict of str to float
        Seconds that each stage has taken since `begin`: "detect", "look", "fit", "check", "gaze".
    """

    found_above = 0.5
    """Confidence from which on a detected face counts."""

    def __init__(self, model: TrackerModel) -> None:
        self._model = model
        self._detector = BoxDetector()
        self.timings: dict[str, float] = dict.fromkeys(STAGES, 0.0)
        self.fitter = FaceFitter(model, self.timings)

    def begin(self) -> None:
        """Measure another image."""
        self.timings.update(dict.fromkeys(STAGES, 0.0))

    def follow(self, grey: NDArray[np.uint8], last: FittedShape) -> Candidate:
        """The face near where it was in the frame before, however unlikely."""
        return self._judged(self.fitter.follow(grey, last))

    def efforts(self, misses: int) -> tuple[Effort, ...]:
        """Those to make in a frame after `misses` frames without a face: all at first, then some in turn."""
        others = EFFORTS[len(_EVERY_FRAME) :]
        return EFFORTS if misses == 0 else (*_EVERY_FRAME, others[misses % len(others)])

    def detect(
        self, grey: NDArray[np.uint8], efforts: Sequence[Effort] = EFFORTS, *, small: bool = False
    ) -> list[Candidate]:
        """Convincing faces, effort by effort, until one finds a face beyond doubt.

        Parameters
        ----------
        grey : (H, W) uint8
        efforts : sequence of Effort
        small : bool
            Whether small faces are looked for in any case, as a certain one is waited for that may be one.
        """
        return list(self._detected(grey, efforts, small))

    def others(
        self, grey: NDArray[np.uint8], pose: FloatArray, efforts: Sequence[Effort] = _QUICK[:1]
    ) -> list[Candidate]:
        """Faces in view that are not the one at `pose` (6,); only boxes beside that one are looked at."""

        def apart(other: FloatArray) -> bool:
            return float(np.hypot(*(other[4:6] - pose[4:6]))) > _APART * float(pose[0])

        starts = [[start for start in self._starts(grey, effort) if apart(start)] for effort in efforts]
        return [c for poses in starts for c in self._faces_in(grey, poses) if apart(c.pose)]

    def neighbours(self, grey: NDArray[np.uint8], pose: FloatArray) -> list[Candidate]:
        """As `others`, with small faces too."""
        return self.others(grey, pose, _QUICK)

    def _detected(self, grey: NDArray[np.uint8], efforts: Sequence[Effort], small: bool) -> Iterator[Candidate]:
        for effort in efforts:
            found = self._faces_in(grey, self._starts(grey, effort))
            yield from found
            certain = any(c.confidence >= _BEYOND_DOUBT for c in found)
            if certain and not (effort == Effort.NEAR and small):
                return

    def _starts(self, grey: NDArray[np.uint8], effort: Effort) -> list[FloatArray]:
        """Frontal poses (6,) of the boxes that the detector proposes."""
        began = perf_counter()
        boxes = self._detector.boxes(grey, effort)[:_MOST_BOXES]
        self.timings["detect"] += perf_counter() - began
        return [box.start_pose(self._model.box_offset) for box in boxes]

    def _faces_in(self, grey: NDArray[np.uint8], poses: Sequence[FloatArray]) -> list[Candidate]:
        """The convincing faces about the given poses (6,)."""
        tried = [self._judged(self.fitter.fit(grey, start, REFINED)) for start in self._promising(grey, poses)]
        return [c for c in tried if c.confidence >= self.found_above]

    def _promising(self, grey: NDArray[np.uint8], poses: Sequence[FloatArray]) -> list[FittedShape]:
        """Coarse fits from the given poses (6,), those first that the face experts score highest."""
        neutral = np.zeros(self._model.pdm.n_modes)
        fits = [self.fitter.fit(grey, FittedShape(pose, neutral), (COARSE,)) for pose in poses]
        fits.sort(key=lambda f: -f.features[1])
        return [f.fitted for f in fits[:_MOST_FACES]]

    def _judged(self, fit: Fit) -> Candidate:
        return Candidate(fit, self._model.check.confidence(fit.features))


def largest(candidates: Sequence[Candidate]) -> Candidate | None:
    """The largest face; of fits that are about as large, which may be of the same face, the most convincing."""
    certain = [c for c in candidates if c.confidence >= _BEYOND_DOUBT] or candidates
    if not certain:
        return None
    size = max(c.pose[0] for c in certain)
    return max((c for c in certain if c.pose[0] > 0.8 * size), key=lambda c: c.confidence)
