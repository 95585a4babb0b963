"""J. Saragih's FaceTracker model (text format) in Facemime's reference frame, with Facemime's mean-shift fit.

Only the learnt parts differ from Facemime's tracker: the shape model and the patch experts. It starts at the pose that
Facemime's tracker finds, with its mean shape, so a face that is not found there counts as lost for both.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from facemime.core.tracking.linear_fitter import RADII, LinearFitter, load_any_model
from facemime.core.tracking.pdm import FittedShape
from facemime.core.tracking.search import STAGES
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker


class Saragih:
    """FaceTracker as a `Peer`; FileNotFoundError if the file is missing."""

    name = "Saragih's model, our fit"

    def __init__(self, path: Path, tracker: FaceTracker) -> None:
        if not path.exists():
            raise FileNotFoundError(f"There is no file {path}.")
        self.tracker = tracker
        model = load_any_model(path, DEFAULT_MODEL)
        assert model.linear is not None
        self.pdm, self.fitter = model.pdm, LinearFitter(model, model.linear, dict.fromkeys(STAGES, 0.0))
        self.fitter.clamp = 5.0  # as in Facemime's own fit
        self._last: FittedShape | None = None

    def locate(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.locate`."""
        result = self.tracker.locate(image)
        if not result.found:
            return result.landmarks
        fitted = self._fit(image, FittedShape(result.pose, np.zeros(self.pdm.n_modes)), RADII)
        return self.pdm.project(fitted.pose, fitted.shape_params)

    def track(self, image: np.ndarray) -> np.ndarray:
        """Track by its own fit from frame to frame, lost if Facemime's tracker is. See `Peer.track`."""
        result = self.tracker.track(image)
        if not result.found:
            self._last = None
            return result.landmarks
        start = self._last or FittedShape(result.pose, np.zeros(self.pdm.n_modes))
        self._last = self._fit(image, start, RADII if self._last is None else RADII[-1:])
        return self.pdm.project(self._last.pose, self._last.shape_params)

    def reset(self) -> None:
        """See `Peer.reset`."""
        self.tracker.reset()
        self._last = None

    def _fit(self, image: np.ndarray, start: FittedShape, radii: tuple[int, ...]) -> FittedShape:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        return self.fitter.fit_linear(grey, start, radii)
