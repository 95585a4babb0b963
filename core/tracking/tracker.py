"""The face tracker: detect, start, fit, check; then from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, as_image
from ..landmarks import MIRROR, N_LANDMARKS
from .check import check_features, response_at
from .detect import EFFORTS, BoxDetector
from .fit import MeanShiftOptions, regularised_mean_shift
from .gaze import find_gaze
from .model_file import TrackerModel, load_model
from .patch_experts import PatchExperts
from .pdm import FittedShape, PointDistributionModel
from .reference import warp_to_reference
from .result import TrackResult

DEFAULT_MODEL = Path(__file__).parents[2] / "assets" / "tracker" / "face.tracker"

SIDE_YAW = 0.36
"""Radians of yaw beyond which the side view's experts take over."""
_TRACK_SCALE = 14.0
"""Pixels an outer-eye distance at which the face's shift between frames is looked for."""
_MAX_CANDIDATES = 6
_BEYOND_DOUBT = 0.8
"""Confidence of a detected face from which on no further effort is made."""
_STAGES = ("detect", "start", "fit", "check", "gaze")


@dataclass(frozen=True)
class Stage:
    """One scale of the fit: index of its experts, window radius in px, and the mean-shift's options."""

    level: int
    radius: int
    options: MeanShiftOptions


COARSE_TO_FINE = (
    Stage(0, 6, MeanShiftOptions((12.0, 8.0, 5.0, 3.0), 0.5)),
    Stage(1, 5, MeanShiftOptions((8.0, 5.0, 3.0, 2.0), 0.3)),
    Stage(2, 5, MeanShiftOptions((6.0, 4.0, 2.0, 1.5, 1.0, 1.0), 0.15)),
)
FRAME_TO_FRAME = (
    Stage(1, 5, MeanShiftOptions((8.0, 5.0, 3.0, 2.0), 0.3)),
    Stage(2, 4, MeanShiftOptions((4.0, 2.0, 1.5, 1.0, 1.0), 0.25)),
)
"""The weights are mostly below 1, so that the prior, too, counts less than in the paper: more, and lids stay open."""


@dataclass(frozen=True)
class _Candidate:
    fitted: FittedShape
    confidence: float
    responses: NDArray[np.float32]


class FaceTracker:
    """Finds one face and follows it: a constrained local model (METHOD section 3).

    `track` continues from the last frame, `locate` looks at one image by itself. `timings` holds the seconds that the
    stages of the last call took: "detect", "start", "fit", "check", "gaze".
    """

    found_above = 0.5
    """Confidence from which on a detected face counts."""
    lost_below = 0.45
    """Confidence below which a followed face counts as lost."""

    def __init__(self, model: TrackerModel) -> None:
        self._model = model
        self._detector = BoxDetector()
        self._views = {
            -1: tuple(e.mirrored(MIRROR) for e in model.side),
            0: model.frontal,
            1: model.side,
        }
        self._visibility = {-1: model.visibility[1][MIRROR], 0: model.visibility[0], 1: model.visibility[1]}
        self._last: FittedShape | None = None
        self._template: NDArray[np.uint8] | None = None
        self._misses = 0
        self.timings: dict[str, float] = dict.fromkeys(_STAGES, 0.0)

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
        """Forget the face that was followed: the next `track` detects."""
        self._last = None
        self._template = None
        self._misses = 0

    def track(self, image: ArrayLike) -> TrackResult:
        """The face in the next frame of a video: (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA.

        Follows the face of the last call; detects where there is none or it is lost.
        """
        grey = _as_grey(image)
        self._start_timings()
        if self._last is not None:
            followed = self._follow(grey, self._last)
            if followed.confidence >= self.lost_below:
                return self._keep(grey, followed)
        # While nobody is in view, each frame makes the quick effort and one of the others, in turn.
        found = self._detect(grey, EFFORTS if self._misses == 0 else (0, 1 + self._misses % 2))
        if found is None:
            self._last = None
            self._misses += 1
            return self._nothing()
        return self._keep(grey, found)

    def locate(self, image: ArrayLike) -> TrackResult:
        """The largest face of a single image; what `track` follows is not touched."""
        grey = _as_grey(image)
        self._start_timings()
        found = self._detect(grey, EFFORTS)
        return self._nothing() if found is None else self._result(grey, found)

    def fit(
        self, grey: NDArray[np.uint8], start: FittedShape, stages: tuple[Stage, ...]
    ) -> tuple[FittedShape, NDArray[np.float32]]:
        """Fit a grey image (H, W) from `start` (image frame); returns the fit and what the check looks at."""
        fitted, responses = start, np.zeros(N_LANDMARKS, np.float32)
        began = perf_counter()
        for stage in stages:
            fitted, responses = self._fit_stage(grey, fitted, stage)
        between = perf_counter()
        features = check_features(grey, fitted.pose, responses)
        self.timings["fit"] += between - began
        self.timings["check"] += perf_counter() - between
        return fitted, features

    def _judged(self, grey: NDArray[np.uint8], start: FittedShape, stages: tuple[Stage, ...]) -> _Candidate:
        fitted, features = self.fit(grey, start, stages)
        return _Candidate(fitted, self._model.check.confidence(features), features[:N_LANDMARKS])

    def _fit_stage(
        self, grey: NDArray[np.uint8], start: FittedShape, stage: Stage
    ) -> tuple[FittedShape, NDArray[np.float32]]:
        view = int(np.sign(start.pose[2])) if abs(start.pose[2]) > SIDE_YAW else 0
        experts: PatchExperts = self._views[view][stage.level]
        frame = warp_to_reference(grey, start.pose, experts.scale)
        local = FittedShape(frame.pose_to_reference(start.pose), start.shape_params)
        centres = np.round(self.pdm.project(local.pose, local.shape_params)).astype(np.intp)
        maps = experts.response_maps(frame.pixels, centres, stage.radius)
        peaks = maps.probability.max(axis=(1, 2))
        np.square(maps.probability, out=maps.probability)
        weights = self._visibility[view] * peaks
        fitted = regularised_mean_shift(self.pdm, local, maps, weights, stage.options)
        landmarks = self.pdm.project(fitted.pose, fitted.shape_params)
        return FittedShape(frame.pose_to_image(fitted.pose), fitted.shape_params), response_at(maps, landmarks)

    def _follow(self, grey: NDArray[np.uint8], last: FittedShape) -> _Candidate:
        began = perf_counter()
        pose = last.pose.copy()
        if self._template is not None:
            pose[4:6] += _shift_since(grey, pose, self._template)
        self.timings["start"] += perf_counter() - began
        return self._judged(grey, FittedShape(pose, last.shape_params), FRAME_TO_FRAME)

    def _detect(self, grey: NDArray[np.uint8], efforts: tuple[int, ...]) -> _Candidate | None:
        """The largest face that convinces, tried box by box; efforts go on until one face is beyond doubt."""
        convincing: list[_Candidate] = []
        for effort in efforts:
            began = perf_counter()
            boxes = self._detector.boxes(grey, effort)
            boxes = sorted(boxes, key=lambda b: -b.box[2])[:_MAX_CANDIDATES]
            self.timings["detect"] += perf_counter() - began
            for face in boxes:
                pose = self._model.start.pose_in_box(face.box, face.detector, face.roll)
                candidate = self._fit_from(grey, pose)
                if candidate.confidence >= self.found_above:
                    convincing.append(candidate)
            if any(c.confidence >= _BEYOND_DOUBT for c in convincing):
                break
        certain = [c for c in convincing if c.confidence >= _BEYOND_DOUBT] or convincing
        if not certain:
            return None
        largest = max(c.fitted.pose[0] for c in certain)
        return max((c for c in certain if c.fitted.pose[0] > 0.8 * largest), key=lambda c: c.confidence)

    def _fit_from(self, grey: NDArray[np.uint8], pose: FloatArray) -> _Candidate:
        began = perf_counter()
        start = self._model.start.refine(self.pdm, grey, pose)
        self.timings["start"] += perf_counter() - began
        return self._judged(grey, start, COARSE_TO_FINE)

    def _keep(self, grey: NDArray[np.uint8], candidate: _Candidate) -> TrackResult:
        self._last, self._misses = candidate.fitted, 0
        self._template = _tracking_window(grey, candidate.fitted.pose, 1.0)
        return self._result(grey, candidate)

    def _result(self, grey: NDArray[np.uint8], candidate: _Candidate) -> TrackResult:
        pose, shape_params = candidate.fitted.pose, candidate.fitted.shape_params
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
            landmark_confidence=candidate.responses.astype(np.float64),
            pupils=gaze.pupils,
            gaze=gaze.direction,
        )

    def _nothing(self) -> TrackResult:
        return TrackResult.nothing(self.pdm.n_modes)

    def _start_timings(self) -> None:
        self.timings = dict.fromkeys(_STAGES, 0.0)


def _as_grey(image: ArrayLike) -> NDArray[np.uint8]:
    pixels = as_image(image)
    return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY).astype(np.uint8)


def _tracking_window(grey: NDArray[np.uint8], pose: FloatArray, reach: float) -> NDArray[np.uint8]:
    size = 2 * round(reach * _TRACK_SCALE)
    return warp_to_reference(grey, pose, _TRACK_SCALE, size).pixels.astype(np.uint8)


def _shift_since(grey: NDArray[np.uint8], pose: FloatArray, template: NDArray[np.uint8]) -> FloatArray:
    """(2,) how far the face, last seen at `pose` (6,) as `template`, has moved; image pixels."""
    window = _tracking_window(grey, pose, 2.0)
    score = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    _, best, _, place = cv2.minMaxLoc(score)
    if best < 0.5:
        return np.zeros(2)
    away = (np.array(place) - (window.shape[0] - template.shape[0]) / 2.0) / _TRACK_SCALE * pose[0]
    length, angle = hypot(*away), atan2(away[1], away[0]) + pose[3]
    return length * np.array([np.cos(angle), np.sin(angle)])
