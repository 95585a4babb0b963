"""A take without the performer's face: the average face, driven as a head is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..apertures import mouth_aperture
from ..takes.neutral import calibrate
from ..takes.take import Take
from ..takes.timing import lose, project
from ..tracking.tracker import FaceTracker
from .retarget import Retargeter

_NOT_PERSONAL = ("fps", "image_size", "model", "clock", "mirrored", "smoothed", "bridged", "punched_in", "interrupted")
"""What an anonymous take still tells of how it was made."""


def anonymise(take: Take) -> Take:
    """The performance without the performer's name and face: an average face that moves as the performer's did.

    Each frame's shape becomes the model's mean face, moved by what `Retargeter` makes of it, and the landmarks follow
    from it; coefficients, pupils and each landmark's confidence, which tell of the performer's own face, are gone, and
    so are the names and dates in `info`. A head is driven as before, up to rounding. How the performer moves, holds the
    head, looks and blinks stays: that is the performance, and somebody who knows the performer may recognise it.
    """
    info = {key: take.info[key] for key in _NOT_PERSONAL if key in take.info}
    result = replace(lose(take, np.ones(len(take), bool)), found=take.found.copy(), info=info)
    result.confidence[:] = take.confidence
    result.pose[:], result.gaze[:] = take.pose, take.gaze
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
