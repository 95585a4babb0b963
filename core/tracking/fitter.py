"""Fitting the shape model to a frame from a given start, stage by stage (method.md, sections 3.3 to 3.5)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from math import inf
from time import perf_counter

import numpy as np

from ..face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, INNER, LIPS, MIRROR, N_LANDMARKS, NOSE
from ..numeric.arrays import FloatArray
from .experts import PartExperts, ResponseMaps
from .grey import Grey
from .mean_shift import Evidence, MeanShiftOptions, regularised_mean_shift
from .model_file import TrackerModel
from .network import N_FEATURES, Outputs
from .pdm import FittedShape, PointDistributionModel
from .reference import pose_in_image

_SIDE_YAW = 0.36
"""Yaw in radians beyond which the visibilities and patch experts of the side view are used."""
HALF_CERTAIN = 0.08
"""`h` of equation 3.2 in eye distances: the standard deviation of a map at which its weight is halved."""
HALF_CERTAIN_GLANCE = 0.1
"""`h` for the glance, in eye distances. Its maps are wider, as their cells are larger."""
_SEEN = 0.65
"""Mean certainty below which a brow may lie above its crop, and above which its eye is where it is expected (section
3.3). Chosen on clips of raised brows."""
_BETTER = 0.02
"""How much more certain a second crop of a brow, above the first, has to be to replace it. Chosen on clips of raised
brows."""
_HIGHER = 0.12
"""How far above the first crop the second lies, in eye distances. Chosen on clips of raised brows; from 0.08 to 0.15 it
shows about the same."""
_AGILITY = np.ones(N_LANDMARKS)
_AGILITY[BROWS] = 4.0
"""Factor of `d` in equation 3.5: a brow that is suddenly raised is far from the shape, and yet no outlier."""
_REFIT_DISTANCE = 0.05
"""Distance in eye distances that a part may move between two frames before its experts are evaluated again."""


@dataclass(frozen=True)
class FitStage:
    """One evaluation of the experts and the fits to their maps.

    Attributes
    ----------
    parts : bool
        Whether to use the experts of the parts and the glance, rather than those of the whole face.
    rounds : tuple of MeanShiftOptions
        Options in eye distances; each round starts from the result of the previous one.
    """

    parts: bool
    rounds: tuple[MeanShiftOptions, ...]


# The table of section 3.4. Three rounds, each with its own Jacobian, let the pose turn far from that of a detected box.
_APPROACH = MeanShiftOptions((inf,), 0.006)
COARSE = FitStage(False, (_APPROACH, _APPROACH, _APPROACH, MeanShiftOptions((0.02, 0.01), 0.006, outlier_scale=0.05)))
FINE = FitStage(True, (MeanShiftOptions((inf, inf), 2e-4, outlier_scale=0.03),))
_HELD = np.array([0.02, 0.05, 0.05, 0.02, 0.01, 0.01])
"""Standard deviations of the pose in the refinement of edges: as a factor, in radians, and in eye distances. With a
third or three times as much, errors of held-out portraits are the same; with the latter, stills jitter more."""
_EDGES = MeanShiftOptions((4e-4, 2e-4), 6e-5, held=_HELD)
"""Chosen on half of the strangers' clips (`lab.bench.strangers`); less regularisation jitters more on stills."""
_EDGED = np.concatenate([BROWS, NOSE[3:], EYE_RIGHT, EYE_LEFT, LIPS])
"""Landmarks that patch experts refine. Along the jaw line and the bridge of the nose an edge does not say where on it a
landmark is; with these, brows and shut lips of strangers are worse (`lab.bench.strangers`, both halves)."""
_NOSE_WEIGHT = 0.3
"""Weight of the nose among them: it holds the pose, but draws inner brows along. Without it, the nose of held-out
portraits is 0.3 % of the eye distance worse; at 1, the signs of hand-labelled inner brows are."""
REFINED = (FINE, FINE)
DETECTED = (COARSE, *REFINED)


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes
    ----------
    fitted : FittedShape
        The fit, in the image frame.
    features : (6,) float64
        Features for `FaceCheck`.
    certainty : (66,) float64
        Certainty of each landmark, 0 to 1.
    moved : float
        Distance across or along the face by which a part has moved from the middle of the crop that its experts saw, in
        eye distances of the start; that of the part that moved furthest, or 0 if the parts were not seen.
    """

    fitted: FittedShape
    features: FloatArray
    certainty: FloatArray
    moved: float = 0.0


@dataclass(frozen=True)
class Look:
    """Response maps, and the standard deviation of a map at which its weight is halved, `h` of equation 3.2."""

    maps: ResponseMaps
    half: float

    @cached_property
    def certainty(self) -> FloatArray:
        """Certainty of each map (equation 3.2), (n,)."""
        return np.asarray(self.half**2 / (self.half**2 + self.maps.moments[1]))

    def distance(self, shape: FloatArray) -> FloatArray:
        """Return the distances from the means of the maps to the landmarks `shape` (66, 2), (n,)."""
        x, y = (self.maps.moments[0] - shape[self.maps.landmarks]).T
        return np.asarray(np.hypot(x, y))


class FaceFitter:
    """Fits the shape model to frames; seconds spent in "experts", "fit" and "check" are added to `timings`.

    Half of the networks run in the `second_thread`, if there is one.
    """

    def __init__(self, model: TrackerModel, timings: dict[str, float]) -> None:
        self._model, self._timings = model, timings
        self.second_thread: Executor | None = None
        # The experts were trained on landmarks of a slightly different definition. The fit uses a mean shape of that
        # definition; results are reported by `pdm` with the same parameters.
        trained = model.pdm.mean_shape - model.definition
        self._fitted_pdm = PointDistributionModel(trained, model.pdm.basis, model.pdm.eigenvalues)
        self._visibility = {-1: model.visibility[1][MIRROR], 0: model.visibility[0], 1: model.visibility[1]}
        frontal, side = model.patches
        self._patches = {
            view: experts.of(_EDGED) for view, experts in ((-1, side.mirrored(MIRROR)), (0, frontal), (1, side))
        }
        # Section 3.3: beside the parts the glance counts little, and less still for landmarks of a part.
        in_parts = np.zeros(N_LANDMARKS, bool)
        for part in model.parts:
            in_parts[part.landmarks] = True
            in_parts[MIRROR[part.landmarks]] |= part.paired
        self._face_weight = np.where(in_parts, 0.1, 0.4)
        weights = np.where(np.isin(_EDGED, NOSE), _NOSE_WEIGHT, 1.0)
        self._edge_weights = {view: weights * visible[_EDGED] for view, visible in self._visibility.items()}

    def fit(self, grey: Grey, start: FittedShape, stages: tuple[FitStage, ...]) -> Fit:
        """Fit a face from `start`, in the image frame, by stages such as `REFINED` or `DETECTED`."""
        out = Fit(start, np.zeros(N_FEATURES), np.zeros(N_LANDMARKS))
        for stage in stages:
            out = self._fit_stage(grey, out.fitted, stage)
        return out

    def follow(self, grey: Grey, last: FittedShape) -> Fit:
        """Fit a face from its fit in the previous frame, in one stage, or two if a part has moved far."""
        fit = self._fit_stage(grey, last, FINE)
        if fit.moved > _REFIT_DISTANCE:
            fit = self._fit_stage(grey, fit.fitted, FINE)
        return fit

    def refine(self, grey: Grey, fit: Fit) -> Fit:
        """Refine the edges of a fit by the patch experts (section 3.5)."""
        began = perf_counter()
        start = fit.fitted
        local, view = _in_face_frame(start), _view(start.pose)
        shape = self._fitted_pdm.project(local.pose, local.shape_params)
        maps, highest = self._patches[view].respond(grey, start.pose, shape)
        looked = perf_counter()
        evidence = [Evidence(maps, self._edge_weights[view] * highest)]
        local = regularised_mean_shift(self._fitted_pdm, local, evidence, _EDGES)
        fitted = FittedShape(pose_in_image(local.pose, start.pose), local.shape_params)
        self._timings["experts"] += looked - began
        self._timings["fit"] += perf_counter() - looked
        return Fit(fitted, fit.features, fit.certainty)

    def _fit_stage(self, grey: Grey, start: FittedShape, stage: FitStage) -> Fit:
        began = perf_counter()
        local = _in_face_frame(start)
        # 1. Response maps (3.3), in the face frame of the start.
        before = self._fitted_pdm.project(local.pose, local.shape_params)
        face, log_odds, parts = self._look(grey, start.pose, before if stage.parts else None)
        looked = perf_counter()
        # 2. Their weights: certainty (3.2) times visibility in this view.
        visible = self._visibility[_view(start.pose)]
        evidence = []
        for look in parts:
            of = look.maps.landmarks
            evidence.append(Evidence(look.maps, look.certainty * visible[of], tolerance=_AGILITY[of]))
        weights = face.certainty * (visible * self._face_weight if parts else visible)
        evidence.append(Evidence(face.maps, weights, coarse=bool(parts)))
        # 3. Mean-shift (3.4); the result is converted back to the image frame.
        for options in stage.rounds:
            local = regularised_mean_shift(self._fitted_pdm, local, evidence, options)
        fitted = FittedShape(pose_in_image(local.pose, start.pose), local.shape_params)
        ended = perf_counter()
        # 4. Features for the loss check (3.6).
        after = self._fitted_pdm.project(local.pose, local.shape_params)
        features, certainty = judge(face, log_odds, parts, after)
        experts = self._model.parts if stage.parts else ()
        moved = max((float(np.abs(part.centres(after - before)).max()) for part in experts), default=0.0)
        self._timings["experts"] += looked - began
        self._timings["fit"] += ended - looked
        self._timings["check"] += perf_counter() - ended
        return Fit(fitted, features, certainty, moved)

    def _look(self, grey: Grey, pose: FloatArray, shape: FloatArray | None) -> tuple[Look, float, list[Look]]:
        """Look at the face, with the log odds that it is one, and at its parts, in the face frame of `pose` (6,).

        Parts are seen where they are in `shape` (66, 2), if there is one. The network of the first part, the eyes,
        takes as long as the others', which run in the second thread; all else is done here, as Python runs one thread
        at a time.
        """
        if shape is None:
            maps, log_odds = self._model.face.respond(grey, pose)
            return Look(maps, HALF_CERTAIN), log_odds, []
        glance, (first, *others) = self._model.glance, self._model.parts
        centres = [part.centres(shape) for part in others]
        whole = glance.crop(grey, pose)
        crops = [part.crops_at(grey, pose, centre) for part, centre in zip(others, centres, strict=True)]

        def of_others() -> tuple[Outputs, list[Outputs]]:
            return glance.network(whole), [part.network(crop) for part, crop in zip(others, crops, strict=True)]

        begun = None if self.second_thread is None else self.second_thread.submit(of_others)
        looks = [self._raised(first, first.respond(grey, pose, shape), grey, pose, shape)]
        of_face, of_parts = of_others() if begun is None else begun.result()
        for part, (output,), centre in zip(others, of_parts, centres, strict=True):
            looks.append(self._raised(part, part.read(output, centre), grey, pose, shape))
        maps, log_odds = glance.read(*of_face)
        return Look(maps, HALF_CERTAIN_GLANCE), log_odds, looks

    def _shape_of(self, fitted: FittedShape) -> FloatArray:
        """Landmarks of a fit in its own face frame, (66, 2), as the networks define them."""
        local = _in_face_frame(fitted)
        return self._fitted_pdm.project(local.pose, local.shape_params)

    def _raised(self, part: PartExperts, maps: ResponseMaps, grey: Grey, pose: FloatArray, shape: FloatArray) -> Look:
        """Look at a part by its `maps`, with brows that are not seen in its crop sought above it (section 3.3).

        The crop lies around the landmarks of the previous frame; a brow that is suddenly raised high is outside.
        """
        look = Look(maps, HALF_CERTAIN)
        if part.shares_of_brows is None:
            return look
        of_brows, of_eyes = part.shares_of_brows
        seen = (of_brows * look.certainty).sum(axis=1)
        if seen.min() > _SEEN:
            return look
        missed = (seen <= _SEEN) & ((of_eyes * look.certainty).sum(axis=1) > _SEEN)
        if not missed.any():
            return look
        above = part.respond(grey, pose, shape, higher=_HIGHER)
        better = missed & ((of_brows * Look(above, HALF_CERTAIN).certainty).sum(axis=1) > seen + _BETTER)
        return Look(maps.replaced(above, (of_brows[better] > 0.0).any(axis=0)), HALF_CERTAIN)


def _in_face_frame(start: FittedShape) -> FittedShape:
    """Convert `start` to its own face frame."""
    return FittedShape(np.array([1.0, start.pose[1], start.pose[2], 0.0, 0.0, 0.0]), start.shape_params)


def _view(pose: FloatArray) -> int:
    """View of a pose: 0 frontal, 1 with the nose to the viewer's left, -1 to the right."""
    return int(np.sign(pose[2])) if abs(pose[2]) > _SIDE_YAW else 0


def judge(face: Look, log_odds: float, parts: Sequence[Look], shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the features (6,), scaled to similar ranges, and the certainty (66,) of a fit at `shape` (66, 2).

    The looks are at the face and at its parts, if these were seen, in the face frame of the shape.
    """
    features, certainty = np.zeros(N_FEATURES), face.certainty.copy()
    features[:4] = 1.0, 0.2 * log_odds, certainty[INNER].mean(), 10.0 * face.distance(shape)[INNER].mean()
    if parts:
        features[4] = np.concatenate([look.certainty for look in parts]).mean()
        features[5] = 10.0 * np.concatenate([look.distance(shape) for look in parts]).mean()
    for look in parts:
        certainty[look.maps.landmarks] = look.certainty
    return features, certainty
