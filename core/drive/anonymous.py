"""Anonymous takes: the performance on the average face (method.md, section 8.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..face.apertures import mouth_aperture
from ..takes.neutral import calibrate
from ..takes.take import Take
from ..takes.timing import mark_lost, project
from ..tracking.tracker import FaceTracker
from .retarget import Retargeter

_KEPT_INFO = (
    *("fps", "image_size", "model", "clock", "measured"),
    *("mirrored", "smoothed", "bridged", "punched_in", "interrupted"),
)
"""Technical entries of `Take.info` that an anonymous take keeps."""


def anonymise(take: Take) -> Take:
    """Remove the performer's name and face from a take; an average face then moves as the performer's did.

    The shape of each frame becomes the mean face of the model, displaced by `Retargeter`, and landmarks follow from it.
    Shape parameters, pupils and landmark confidences, which depend on the performer's face, are removed, as are names
    and dates in `info`. The take drives a head as before, up to rounding. The motion remains, and somebody who knows
    the performer may recognise them by it.
    """
    info = {key: take.info[key] for key in _KEPT_INFO if key in take.info}
    result = replace(mark_lost(take, np.ones(len(take), bool)), found=take.found.copy(), info=info)
    result.confidence[:] = take.confidence
    for name in ("pose", "gaze", "vergence", "actions", "coefficients"):
        getattr(result, name)[:] = getattr(take, name)
    if not take.found.any():
        return result
    neutral, mean = calibrate(take), FaceTracker.load().pdm.mean_shape
    retargeter = Retargeter(neutral.shape, mean)
    for frame in np.flatnonzero(take.found).tolist():
        result.shape[frame] = mean + retargeter.displacements(take.shape[frame])
    seen = result.found
    result.landmarks[seen] = project(result.shape[seen].astype(np.float64), result.pose[seen])
    opened = neutral.open_mouth - float(mouth_aperture(neutral.shape))
    average = replace(neutral, shape=mean, open_mouth=float(mouth_aperture(mean)) + opened)
    return replace(result, info={**info, "calibration": average.to_dict()})
