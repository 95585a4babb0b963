"""One frame: look with the experts, fit the shape model, look again; from a given start (METHOD section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..landmarks import INNER, MIRROR, N_LANDMARKS
from .check import N_FEATURES
from .experts import ResponseMaps
from .mean_shift import Evidence, MeanShiftOptions, regularised_mean_shift
from .model_file import TrackerModel
from .pdm import FittedShape, PointDistributionModel
from .reference import pose_in_image

_SIDE_YAW = 0.36
"""Radians of yaw beyond which the side view's visibility and patch experts count."""
_CERTAIN, _CERTAIN_AT_A_GLANCE = 0.08, 0.1
"""Standard deviation of a response map, in eye distances, at which its landmark is trusted half; a glance's maps are
the wider the larger their cells are."""
_FAR = 0.05
"""Eye distances by which a part may have moved since the last frame before it is looked at again."""


@dataclass(frozen=True)
class Stage:
    """One look and the fit to it.

    Attributes
    ----------
    parts : bool
        Whether the parts' experts look, and the whole face is only glanced at; otherwise it is all that is looked at.
    rounds : tuple of MeanShiftOptions
        In eye distances; each starts from where the last one ended.
    """

    parts: bool
    rounds: tuple[MeanShiftOptions, ...]


_TOWARDS = MeanShiftOptions((inf,), 0.006)
COARSE = Stage(False, (_TOWARDS, _TOWARDS, _TOWARDS, MeanShiftOptions((0.02, 0.01), 0.006, doubt=0.05)))
FINE = Stage(True, (MeanShiftOptions((inf, inf, inf), 2e-4, doubt=0.03),))
_EDGES = MeanShiftOptions((4e-4, 2e-4), 3e-5)
REFINED = (FINE, FINE)
DETECTED = (COARSE, *REFINED)


@dataclass(frozen=True)
class Fit:
    """Where a fit ended (image frame), what the check looks at, and how certain each landmark is (66,)."""

    fitted: FittedShape
    features: FloatArray
    certainty: FloatArray


class FaceFitter:
    """The fit of a model to a frame.

    Parameters
    ----------
    model : TrackerModel
    timings : dict of str to float
        The seconds that "look", "fit" and "check" took are added there.
    """

    def __init__(self, model: TrackerModel, timings: dict[str, float]) -> None:
        self._model, self._timings = model, timings
        # Fitted are the places that the experts were taught; reported is where `pdm` has the same shape.
        taught = model.pdm.mean_shape - model.definition
        self._taught = PointDistributionModel(taught, model.pdm.basis, model.pdm.eigenvalues)
        self._visibility = {-1: model.visibility[1][MIRROR], 0: model.visibility[0], 1: model.visibility[1]}
        frontal, side = model.patches
        self._patches = {-1: side.mirrored(MIRROR), 0: frontal, 1: side}
        in_parts = np.zeros(N_LANDMARKS, bool)
        for part in model.parts:
            in_parts[part.landmarks] = True
            in_parts[MIRROR[part.landmarks]] |= part.paired
        self._face_weight = np.where(in_parts, 0.1, 0.4)

    def fit(self, grey: NDArray[np.uint8], start: FittedShape, stages: tuple[Stage, ...]) -> Fit:
        """Fit a grey image (H, W) from `start` (image frame)."""
        out = Fit(start, np.zeros(N_FEATURES), np.zeros(N_LANDMARKS))
        for stage in stages:
            out = self._fit_stage(grey, out.fitted, stage)
        return self._on_edges(grey, out) if stages[-1].parts else out

    def follow(self, grey: NDArray[np.uint8], last: FittedShape) -> Fit:
        """Fit a grey image (H, W) from where the face was a frame ago: one look, or two where it moved far."""
        fit = self._fit_stage(grey, last, FINE)
        if self._moved_far(last, fit.fitted):
            fit = self._fit_stage(grey, fit.fitted, FINE)
        return self._on_edges(grey, fit)

    def _fit_stage(self, grey: NDArray[np.uint8], start: FittedShape, stage: Stage) -> Fit:
        began = perf_counter()
        local = _in_face_frame(start)
        face, log_odds = (self._model.glance if stage.parts else self._model.face).look(grey, start.pose)
        shape = self._taught.project(local.pose, local.shape_params)
        maps = [part.look(grey, start.pose, shape) for part in self._model.parts] if stage.parts else []
        looked = perf_counter()
        visible = self._visibility[_view(start.pose)]
        certainty = _certainty(face, _CERTAIN_AT_A_GLANCE if maps else _CERTAIN)
        of_parts = [_certainty(m, _CERTAIN) for m in maps]
        evidence = [Evidence(m, c * visible[m.landmarks]) for m, c in zip(maps, of_parts, strict=True)]
        evidence += [Evidence(face, certainty * visible * (self._face_weight if maps else 1.0), coarse=bool(maps))]
        for options in stage.rounds:
            local = regularised_mean_shift(self._taught, local, evidence, options)
        fitted = FittedShape(pose_in_image(local.pose, start.pose), local.shape_params)
        ended = perf_counter()
        shape = self._taught.project(local.pose, local.shape_params)
        features = np.zeros(N_FEATURES)
        features[:4] = 1.0, 0.2 * log_odds, certainty[INNER].mean(), 10.0 * _distance(face, shape)[INNER].mean()
        if maps:
            away = np.concatenate([_distance(m, shape) for m in maps])
            features[4:] = np.concatenate(of_parts).mean(), 10.0 * away.mean()
        for m, c in zip(maps, of_parts, strict=True):
            certainty[m.landmarks] = c
        self._timings["look"] += looked - began
        self._timings["fit"] += ended - looked
        self._timings["check"] += perf_counter() - ended
        return Fit(fitted, features, certainty)

    def _on_edges(self, grey: NDArray[np.uint8], fit: Fit) -> Fit:
        """The fit after the patch experts had their last word."""
        began = perf_counter()
        start = fit.fitted
        local, view = _in_face_frame(start), _view(start.pose)
        shape = self._taught.project(local.pose, local.shape_params)
        maps, highest = self._patches[view].look(grey, start.pose, shape)
        looked = perf_counter()
        evidence = [Evidence(maps, self._visibility[view] * highest)]
        local = regularised_mean_shift(self._taught, local, evidence, _EDGES)
        fitted = FittedShape(pose_in_image(local.pose, start.pose), local.shape_params)
        self._timings["look"] += looked - began
        self._timings["fit"] += perf_counter() - looked
        return Fit(fitted, fit.features, fit.certainty)

    def _moved_far(self, before: FittedShape, now: FittedShape) -> bool:
        """Whether some part left the middle of the picture in which its experts looked for it."""
        pdm = self._model.pdm
        moved = pdm.project(now.pose, now.shape_params) - pdm.project(before.pose, before.shape_params)
        parts = [np.abs(moved[part.landmarks].sum(axis=0)).max() / len(part.landmarks) for part in self._model.parts]
        return bool(max(parts) > _FAR * before.pose[0])


def _in_face_frame(start: FittedShape) -> FittedShape:
    """`start` in its own face frame."""
    return FittedShape(np.array([1.0, start.pose[1], start.pose[2], 0.0, 0.0, 0.0]), start.shape_params)


def _view(pose: FloatArray) -> int:
    """0 frontal, 1 with the nose to the viewer's left, -1 to the right."""
    return int(np.sign(pose[2])) if abs(pose[2]) > _SIDE_YAW else 0


def _certainty(maps: ResponseMaps, half: float) -> FloatArray:
    """(n,) 0 to 1: how narrow each map is; a standard deviation of `half`, in eye distances, gives 0.5."""
    return np.asarray(half**2 / (half**2 + maps.moments[1]))


def _distance(maps: ResponseMaps, shape: FloatArray) -> FloatArray:
    """(n,) from the maps' means to the landmarks `shape` (66, 2)."""
    away = maps.moments[0] - shape[maps.landmarks]
    out: FloatArray = np.hypot(away[:, 0], away[:, 1])
    return out
