"""Fitting a user's shape model by its linear experts alone, the original method (method.md, section 3.12)."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from pathlib import Path
from time import perf_counter

import numpy as np

from .facetracker_file import is_text_model, read_facetracker
from .fitter import HALF_CERTAIN, HALF_CERTAIN_GLANCE, FaceFitter, Fit, FitStage, Look, judge
from .grey import Grey
from .linear_experts import REACH, LinearModel
from .mean_shift import Evidence, MeanShiftOptions, regularised_mean_shift
from .model_file import TrackerModel, load_model
from .pdm import FittedShape
from .reference import pose_in_image, warp_to_reference

RADII = (5, 4, 3)
"""Radii of the search windows in pixels, coarse to fine: 11, 9 and 7 pixels wide, as in FaceTracker."""
_ITERATIONS = 10
"""Iterations in each window, each with its own Jacobian."""
_REGULARISATION = 0.5
"""Weight of the prior in units of the variance, as in FaceTracker."""
_MARGIN = 9
"""Pixels about the reference frame beyond patches, for the widest window and the gradients."""


def load_any_model(path: Path, shipped: Path) -> TrackerModel:
    """Read a tracker model, or one of FaceTracker, to which the `shipped` one adds what finds and checks faces.

    Raises ModelError if it is missing, damaged, or of another kind.
    """
    if not is_text_model(path):
        return load_model(path)
    model = load_model(shipped)
    linear = read_facetracker(path, model.pdm)
    # Networks that judge a fit were trained on landmarks of our definition, `mean_shape - definition`.
    definition = linear.pdm.mean_shape - (model.pdm.mean_shape - model.definition)
    return replace(model, pdm=linear.pdm, definition=definition, linear=linear, model_id=linear.model_id)


class LinearFitter(FaceFitter):
    """Fits by linear experts; the networks of `FaceFitter` only judge where the fit ended."""

    clamp = 3.0
    """Largest coefficient in standard deviations, as in FaceTracker."""

    def __init__(self, model: TrackerModel, linear: LinearModel, timings: dict[str, float]) -> None:
        super().__init__(model, timings)
        self._linear = linear

    def fit(self, grey: Grey, start: FittedShape, stages: tuple[FitStage, ...]) -> Fit:
        """Fit a face from `start`, in all windows; for a coarse stage only its pose, in the widest one."""
        parts = stages[-1].parts
        fitted = self.fit_linear(grey, start, RADII if parts else RADII[:1])
        if not parts:  # far from the face, a wide window may open the mouth, which narrower ones do not shut
            fitted = FittedShape(fitted.pose, np.zeros_like(fitted.shape_params))
        return self._judged(grey, fitted, parts)

    def follow(self, grey: Grey, last: FittedShape) -> Fit:
        """Fit a face from its fit in the previous frame."""
        return self._judged(grey, self.fit_linear(grey, last, RADII), True)

    def refine(self, grey: Grey, fit: Fit) -> Fit:
        """Return a fit as it is, since the linear experts end at the edges."""
        return fit

    def fit_linear(self, grey: Grey, start: FittedShape, radii: tuple[int, ...]) -> FittedShape:
        """Fit the shape model from `start`, in the image frame, in windows of each of `radii` in turn."""
        pdm, scale, fitted = self._linear.pdm, self._linear.scale, start
        for radius in radii:
            began = perf_counter()
            view = self._linear.view(fitted.pose)
            size = 2 * ceil(REACH * scale + view.half + _MARGIN)
            middle = (size - 1) / 2.0
            pixels = warp_to_reference(grey, fitted.pose, scale, (size, size)).pixels.astype(np.float32)
            pose = np.array([scale, *fitted.pose[1:3], 0.0, middle, middle])
            local = FittedShape(pose, fitted.shape_params)
            # A shape far outside the frame is drawn back in by its windows.
            places = np.clip(pdm.project(local.pose, local.shape_params), 0.0, size)
            evidence = [Evidence(view.respond(pixels, np.round(places).astype(np.intp), radius), view.visible)]
            looked = perf_counter()
            variance = (2 * radius + 1) ** 2 / 36.0
            for _ in range(_ITERATIONS):
                options = MeanShiftOptions((variance,), _REGULARISATION * variance)
                local = regularised_mean_shift(pdm, local, evidence, options)
                local = FittedShape(local.pose, pdm.clamp(local.shape_params, self.clamp))
            s, pitch, yaw, roll, x, y = local.pose.tolist()
            relative = np.array([s / scale, pitch, yaw, roll, (x - middle) / scale, (y - middle) / scale])
            fitted = FittedShape(pose_in_image(relative, fitted.pose), local.shape_params)
            self._timings["experts"] += looked - began
            self._timings["fit"] += perf_counter() - looked
        return fitted

    def _judged(self, grey: Grey, fitted: FittedShape, parts: bool) -> Fit:
        """Judge a fit by the networks of the face, and of its `parts`, seen where it ended."""
        began = perf_counter()
        experts, half = (self._model.glance, HALF_CERTAIN_GLANCE) if parts else (self._model.face, HALF_CERTAIN)
        face, log_odds = experts.respond(grey, fitted.pose)
        shape = self._shape_of(fitted)
        maps = [part.respond(grey, fitted.pose, shape) for part in self._model.parts] if parts else []
        looks = [Look(m, HALF_CERTAIN) for m in maps]
        features, certainty = judge(Look(face, half), log_odds, looks, shape)
        self._timings["check"] += perf_counter() - began
        return Fit(fitted, features, certainty)
