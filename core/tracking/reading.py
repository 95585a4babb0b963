"""What a face shows where a fit ended: its edges, teeth, pupils and actions (method.md, sections 3.5 and 3.8)."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .experts import standardise_part
from .fitter import FaceFitter
from .gaze import find_gaze
from .grey import Grey
from .lids import pair_lids
from .model_file import TrackerModel
from .patch_experts import ActionExperts, measure_actions
from .result import HiddenMouth, TrackResult, project_shape
from .search import Candidate
from .teeth import bare_teeth


class FaceReader:
    """Reads a face where a fit ended; seconds spent are added to `timings`, as in `search.STAGES`."""

    def __init__(self, model: TrackerModel, fitter: FaceFitter, timings: dict[str, float]) -> None:
        self._model, self._fitter, self._timings = model, fitter, timings

    def read(
        self,
        grey: Grey,
        colour: NDArray[np.uint8] | None,
        candidate: Candidate,
        mouth: HiddenMouth | None = None,
        parts: Sequence[ActionExperts] | None = None,
        before: FloatArray | None = None,
    ) -> TrackResult:
        """Return the result for a face in an image in `grey`, and in `colour` (H, W, 3 or 4) unless it has none.

        The actions are those of `parts`, by default of all; those of other parts are taken from `before` (15,). Hidden
        lips are as `mouth` remembers them.
        """
        # The networks of pupils and actions see the face before its edges are refined, which moves their crops by at
        # most half a pixel: while this thread refines the edges, the second one, if there is one, runs these networks.
        # This one crops for them and reads what they tell, as Python runs one thread at a time.
        pdm, pupils, timings = self._model.pdm, self._model.pupils, self._timings
        began = perf_counter()
        fitted = candidate.fit.fitted
        landmarks = pdm.project(fitted.pose, fitted.shape_params)
        experts = self._model.actions if parts is None else parts
        crops = [part.crops_at(grey, fitted.pose, landmarks) for part in experts]
        cropped = perf_counter()
        band = pupils.band(grey, fitted.pose, landmarks)
        eyes = standardise_part(band.pixels)[None]
        timings["actions"] += cropped - began
        timings["gaze"] += perf_counter() - cropped

        def run_networks() -> tuple[FloatArray, NDArray[np.float32]]:
            began = perf_counter()
            actions = measure_actions(experts, crops, before)
            measured = perf_counter()
            (places,) = pupils.network(eyes)
            timings["actions"] += measured - began
            timings["gaze"] += perf_counter() - measured
            return actions, places

        thread = self._fitter.second_thread
        begun = None if thread is None else thread.submit(run_networks)
        fitted = self._fitter.refine(grey, candidate.fit).fitted
        pose, shape_params = fitted.pose, fitted.shape_params
        shape = pair_lids(pose, pdm.shape(shape_params))
        landmarks = project_shape(shape, pose)
        refined = perf_counter()
        teeth = nan
        if colour is not None:
            bared, teeth = bare_teeth(colour, pose, landmarks, shape)
            if bared is not shape:
                shape, landmarks = bared, project_shape(bared, pose)
        timings["teeth"] += perf_counter() - refined
        if mouth is not None and (held := mouth.hold(shape, candidate.fit.certainty)) is not shape:
            shape, landmarks, teeth = held, project_shape(held, pose), nan
        actions, places = run_networks() if begun is None else begun.result()
        told = perf_counter()
        gaze = find_gaze(pupils.refine(band, places), pose, landmarks, shape)
        timings["gaze"] += perf_counter() - told
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
            vergence=gaze.vergence,
            actions=actions,
            teeth=teeth,
        )
