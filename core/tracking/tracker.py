"""The face tracker: detect, look, fit, check; then from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, as_image
from ..assets import ASSETS
from .company import Company, portrait
from .detect import EFFORTS, BoxDetector, Effort
from .fitter import COARSE, REFINED, FaceFitter, Fit
from .gaze import find_gaze
from .model_file import TrackerModel, load_model
from .pdm import FittedShape, PointDistributionModel
from .result import TrackResult

DEFAULT_MODEL = ASSETS / "tracker" / "face.tracker"

_MOST_BOXES, _MOST_FACES = 60, 4
"""How many boxes of an effort are looked at, and how many of them are fitted to the end."""
_BEYOND_DOUBT = 0.85
"""Confidence of a detected face from which on no further effort is made."""
_REMEMBERED, _BEHIND = 25, 75
"""Frames for which a lost face is waited for where it was before another one is taken: after a cut, or where it left,
and while somebody else stands before it."""
_LOOKED_AT = 3
"""Every so many frames it is looked at who is followed."""
_APART = 0.6
"""Eye distances between the centres of two fits from which on they are two people's."""
_QUICK = (Effort.NEAR, Effort.SMALL)
"""The efforts that look for others in view."""
_EVERY_FRAME = (*_QUICK, Effort.FILLING)
"""Those that are made in every frame while nobody is in view, beside one of the others in turn."""
LEFTMOST, RIGHTMOST = (-1e6, 0.0), (1e6, 0.0)
"""Places for `FaceTracker.choose`: far out to either side."""
_STAGES = ("detect", "look", "fit", "check", "gaze")


@dataclass(frozen=True)
class _Candidate:
    fit: Fit
    confidence: float

    @property
    def pose(self) -> FloatArray:
        return self.fit.fitted.pose


class FaceTracker:
    """Finds one face and follows it: a constrained local model (METHOD section 3).

    `track` continues from the last frame, `locate` looks at one image by itself. `timings` holds the seconds that the
    stages of the last call took: "detect", "look", "fit", "check", "gaze".

    Of several faces the largest is followed, or the one that `choose` names. A face that was lost is taken up again
    where it was before another one is; while it is followed, others may pass, also before it: it is then lost until it
    is seen again, for three seconds at 25 frames a second.
    """

    found_above = 0.5
    """Confidence from which on a detected face counts."""
    lost_below = 0.3
    """Confidence below which a followed face counts as lost: a hand before it is no reason to let go."""

    def __init__(self, model: TrackerModel) -> None:
        self._model = model
        self._detector = BoxDetector()
        self.timings: dict[str, float] = dict.fromkeys(_STAGES, 0.0)
        self.fitter = FaceFitter(model, self.timings)
        self._last: FittedShape | None = None
        self._wanted: FloatArray | None = None
        self._lost: FittedShape | None = None
        self._misses, self._another = 0, False
        self._company = Company()

    @classmethod
    def load(cls, path: Path | None = None) -> FaceTracker:
        """A tracker with the model file at `path`, by default the one that is shipped; ModelError where it is bad."""
        return cls(load_model(DEFAULT_MODEL if path is None else Path(path)))

    @property
    def pdm(self) -> PointDistributionModel:
        """The shape model."""
        return self._model.pdm

    @property
    def model_id(self) -> str:
        """First digits of the model file's checksum."""
        return self._model.model_id

    def reset(self) -> None:
        """Forget the face that was followed and any choice: the next `track` detects."""
        self._last = self._lost = self._wanted = None
        self._misses, self._another = 0, False
        self._company.forget()

    def choose(self, x: float, y: float) -> None:
        """Follow the face nearest to the place (x, y), pixels, from the next `track` on."""
        self.reset()
        self._wanted = np.array([x, y], np.float64)

    def choose_next(self) -> None:
        """Follow another face from the next `track` on: the next to the right, or the leftmost; or stay, if alone."""
        self._another = True

    def track(self, image: ArrayLike) -> TrackResult:
        """The face in the next frame of a video: (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA.

        Follows the face of the last call; detects where there is none or it is lost.
        """
        grey = self._begin(image)
        self._company.frame += 1
        if self._another and (another := self._next(grey)) is not None:
            self._company.forget()
            return self._keep(grey, another)
        if self._last is not None:
            followed = self._judged(self.fitter.follow(grey, self._last))
            if followed.confidence >= self.lost_below and self._is_same(grey, followed):
                return self._keep(grey, followed)
            self._lost = self._last
        others = EFFORTS[len(_EVERY_FRAME) :]
        efforts = EFFORTS if self._misses == 0 else (*_EVERY_FRAME, others[self._misses % len(others)])
        found = self._chosen(grey, list(self._detect(grey, efforts)))
        if found is None:
            self._last = None
            self._misses += 1
            return TrackResult.nothing(self.pdm.n_modes)
        return self._keep(grey, found)

    def locate(self, image: ArrayLike) -> TrackResult:
        """The largest face of a single image; what `track` follows is not touched."""
        grey = self._begin(image)
        found = _largest(list(self._detect(grey, EFFORTS)))
        return TrackResult.nothing(self.pdm.n_modes) if found is None else self._result(grey, found)

    def _begin(self, image: ArrayLike) -> NDArray[np.uint8]:
        self.timings.update(dict.fromkeys(_STAGES, 0.0))
        pixels = as_image(image)
        return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)

    def _judged(self, fit: Fit) -> _Candidate:
        return _Candidate(fit, self._model.check.confidence(fit.features))

    def _is_same(self, grey: NDArray[np.uint8], followed: _Candidate) -> bool:
        """Whether the face that is followed is still whose it was, and nobody's who stepped before it."""
        company = self._company
        if company.frame % _LOOKED_AT:
            return True
        look = portrait(grey, followed.pose)
        if company.knows(look):
            return True
        if company.is_other(look):
            company.meet(look, followed.pose)
            return False
        if company.crowded or company.worth_a_search:
            for other in self._others(grey, followed.pose, _QUICK[0]):
                company.meet(portrait(grey, other.pose), other.pose)
        company.get_used_to(look)
        return True

    def _next(self, grey: NDArray[np.uint8]) -> _Candidate | None:
        """The face to the right of the one that is followed, or the leftmost; None where there is no other."""
        self._another = False
        if self._last is None:
            return None
        here = self._last.pose
        found = [c for effort in _QUICK for c in self._others(grey, here, effort)]
        return min([c for c in found if c.pose[4] > here[4]] or found, key=lambda c: float(c.pose[4]), default=None)

    def _others(self, grey: NDArray[np.uint8], pose: FloatArray, effort: Effort) -> list[_Candidate]:
        """Faces in view that are not the one at `pose` (6,); only boxes beside that one are looked at."""

        def apart(other: FloatArray) -> bool:
            return float(np.hypot(*(other[4:6] - pose[4:6]))) > _APART * float(pose[0])

        return [c for c in self._faces_in(grey, [p for p in self._starts(grey, effort) if apart(p)]) if apart(c.pose)]

    def _detect(self, grey: NDArray[np.uint8], efforts: tuple[Effort, ...]) -> Iterator[_Candidate]:
        """Convincing faces, effort by effort; none is made after one that finds a face beyond doubt.

        Where a certain face is waited for, which may be a small one, the smaller ones are looked at in any case.
        """
        for effort in efforts:
            found = self._faces_in(grey, self._starts(grey, effort))
            yield from found
            certain = any(c.confidence >= _BEYOND_DOUBT for c in found)
            if certain and not (effort == Effort.NEAR and self._waited_for):
                return

    def _starts(self, grey: NDArray[np.uint8], effort: Effort) -> list[FloatArray]:
        """Frontal poses (6,) of the boxes that the detector proposes."""
        began = perf_counter()
        boxes = self._detector.boxes(grey, effort)[:_MOST_BOXES]
        self.timings["detect"] += perf_counter() - began
        return [box.start_pose(self._model.box_offset) for box in boxes]

    def _faces_in(self, grey: NDArray[np.uint8], poses: list[FloatArray]) -> list[_Candidate]:
        """The convincing faces about the given poses (6,)."""
        tried = [self._judged(self.fitter.fit(grey, start, REFINED)) for start in self._promising(grey, poses)]
        return [c for c in tried if c.confidence >= self.found_above]

    @property
    def _waited_for(self) -> bool:
        return self._wanted is not None or self._lost is not None

    def _promising(self, grey: NDArray[np.uint8], poses: list[FloatArray]) -> list[FittedShape]:
        """Coarse fits from the given poses (6,), those first that the face experts think most of."""
        fits = [self.fitter.fit(grey, FittedShape(pose, np.zeros(self.pdm.n_modes)), (COARSE,)) for pose in poses]
        fits.sort(key=lambda f: -f.features[1])
        return [f.fitted for f in fits[:_MOST_FACES]]

    def _chosen(self, grey: NDArray[np.uint8], candidates: list[_Candidate]) -> _Candidate | None:
        """The face that the user named; else the one that was lost, while it is waited for; else the largest."""
        if self._wanted is not None and candidates:
            x, y = self._wanted
            return min(candidates, key=lambda c: float(np.hypot(c.pose[4] - x, c.pose[5] - y)))
        if self._lost is not None and self._misses < (_BEHIND if self._company.crowded else _REMEMBERED):
            poses = [c.pose for c in candidates]
            candidates = [candidates[i] for i in self._company.returned([portrait(grey, p) for p in poses], poses)]
            pose, reach = self._lost.pose, 1.5 + 0.2 * self._misses
            candidates = [
                c
                for c in candidates
                if np.hypot(*(c.pose[4:6] - pose[4:6])) < reach * pose[0] and 0.6 < c.pose[0] / pose[0] < 1.7
            ]
            return _largest(candidates)
        self._company.forget()
        return _largest(candidates)

    def _keep(self, grey: NDArray[np.uint8], candidate: _Candidate) -> TrackResult:
        self._last, self._lost, self._wanted, self._misses = candidate.fit.fitted, None, None, 0
        return self._result(grey, candidate)

    def _result(self, grey: NDArray[np.uint8], candidate: _Candidate) -> TrackResult:
        pose, shape_params = candidate.fit.fitted.pose, candidate.fit.fitted.shape_params
        landmarks, shape = self.pdm.project(pose, shape_params), self.pdm.shape(shape_params)
        began = perf_counter()
        gaze = find_gaze(grey, pose, landmarks, shape)
        self.timings["gaze"] += perf_counter() - began
        return TrackResult(
            found=True,
            landmarks=landmarks,
            pose=pose,
            shape_params=shape_params,
            shape=shape,
            confidence=candidate.confidence,
            landmark_confidence=candidate.fit.certainty,
            pupils=gaze.pupils,
            gaze=gaze.direction,
        )


def _largest(candidates: list[_Candidate]) -> _Candidate | None:
    """The largest face; of fits that are about as large, which may be of the same face, the most convincing."""
    certain = [c for c in candidates if c.confidence >= _BEYOND_DOUBT] or candidates
    if not certain:
        return None
    largest = max(c.pose[0] for c in certain)
    return max((c for c in certain if c.pose[0] > 0.8 * largest), key=lambda c: c.confidence)
