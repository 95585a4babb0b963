"""The face tracker: search, choose, follow from frame to frame, and notice whose face it is (METHOD section 3)."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import as_image
from ..assets import ASSETS
from .choice import FaceChoice
from .fitter import FaceFitter
from .gaze import find_gaze
from .identity import Identity, portrait
from .model_file import TrackerModel, load_model
from .pdm import FittedShape, PointDistributionModel
from .result import TrackResult
from .search import Candidate, FaceSearch, largest

DEFAULT_MODEL = ASSETS / "tracker" / "face.tracker"

_LOOKED_AT = 3
"""Every so many frames it is checked whose face is tracked."""


class FaceTracker:
    """Finds one face and follows it: a constrained local model.

    `track` continues from the last frame, `locate` looks at one image by itself.

    Of several faces the largest is tracked, or the one that `choose` names. A face that was lost is taken up again
    where it was before another one is; while it is tracked, others may pass, also in front of it: it is then lost until
    it is seen again, for three seconds at 25 frames a second.

    Parameters
    ----------
    model : TrackerModel
    """

    lost_below = 0.3
    """Confidence below which a tracked face counts as lost: a hand in front of it is no reason to let go."""

    def __init__(self, model: TrackerModel) -> None:
        self._model = model
        self._search = FaceSearch(model)
        self._identity = Identity()
        self._choice = FaceChoice()
        self._last: FittedShape | None = None
        self._another = False

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

    @property
    def fitter(self) -> FaceFitter:
        """What fits the shape model to an image."""
        return self._search.fitter

    @property
    def timings(self) -> dict[str, float]:
        """Seconds that the stages of the last call took: "detect", "look", "fit", "check", "gaze"."""
        return self._search.timings

    def reset(self) -> None:
        """Forget the face that was tracked and any choice: the next `track` detects."""
        self._last, self._another = None, False
        self._choice = FaceChoice()
        self._identity.reset()

    def choose(self, x: float, y: float) -> None:
        """Track the face nearest to the place (x, y), pixels, from the next `track` on."""
        self.reset()
        self._choice.name(x, y)

    def choose_next(self) -> None:
        """Track another face from the next `track` on: the next to the right, or the leftmost; or stay, if alone."""
        self._another = True

    def track(self, image: ArrayLike) -> TrackResult:
        """The face in the next frame of a video: (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA.

        Follows the face of the last call; detects where there is none or it is lost.
        """
        grey = self._begin(image)
        self._identity.frame += 1
        # 1. Another face, where the user asked for one and it is in view.
        if self._another and (another := self._next(grey)) is not None:
            self._identity.reset()
            return self._keep(grey, another)
        # 2. The face of the last frame, fitted from where it was; accepted while it is a face, and still the same.
        if self._last is not None:
            followed = self._search.follow(grey, self._last)
            if followed.confidence >= self.lost_below and self._is_same(grey, followed):
                return self._keep(grey, followed)
            self._choice.lose(self._last)
        # 3. All faces in view, and of these the performer's.
        efforts = self._search.efforts(self._choice.misses)
        found = self._search.detect(grey, efforts, small=self._choice.waiting)
        chosen = self._choice.pick(grey, found, self._identity)
        if chosen is None:
            self._last = None
            self._choice.misses += 1
            return TrackResult.nothing(self.pdm.n_modes)
        return self._keep(grey, chosen)

    def locate(self, image: ArrayLike) -> TrackResult:
        """The largest face of a single image; what `track` follows is not touched."""
        grey = self._begin(image)
        found = largest(self._search.detect(grey, small=self._choice.waiting))
        return TrackResult.nothing(self.pdm.n_modes) if found is None else self._result(grey, found)

    def _begin(self, image: ArrayLike) -> NDArray[np.uint8]:
        self._search.begin()
        pixels = as_image(image)
        return pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)

    def _is_same(self, grey: NDArray[np.uint8], followed: Candidate) -> bool:
        """Whether the tracked face is still whose it was, and nobody's who stepped in front of it."""
        identity = self._identity
        if identity.frame % _LOOKED_AT:
            return True
        look = portrait(grey, followed.pose)
        if identity.recognises(look):
            return True
        if identity.is_bystander(look):
            identity.update_bystander(look, followed.pose)
            return False
        # It looks like nobody who is known. Whoever else is in view is not the performer: learn what they look like,
        # so that the next such face can be told apart; with nobody there, it is a hand, a shadow or a new light.
        if identity.crowded or identity.search_due:
            for other in self._search.others(grey, followed.pose):
                identity.update_bystander(portrait(grey, other.pose), other.pose)
        identity.adapt(look)
        return True

    def _next(self, grey: NDArray[np.uint8]) -> Candidate | None:
        """The face to the right of the tracked one, or the leftmost; None where there is no other."""
        self._another = False
        if self._last is None:
            return None
        here = self._last.pose
        found = self._search.neighbours(grey, here)
        return min([c for c in found if c.pose[4] > here[4]] or found, key=lambda c: float(c.pose[4]), default=None)

    def _keep(self, grey: NDArray[np.uint8], candidate: Candidate) -> TrackResult:
        self._last = candidate.fit.fitted
        self._choice.settle()
        return self._result(grey, candidate)

    def _result(self, grey: NDArray[np.uint8], candidate: Candidate) -> TrackResult:
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
