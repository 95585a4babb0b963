"""Doubtful frames: where the tracker was least sure, and a user should look first."""

from __future__ import annotations

import numpy as np

from ..numeric.arrays import FloatArray, IntArray
from .learnt import PARTS
from .mending import find_outliers
from .pins import frames_of_pins, pins_of
from .take import Take

APART = 0.5
"""Least time in seconds between two doubtful frames, and between one and a pin."""
_LEAST = 0.1
"""Usual uncertainty below which it is not compared, as the face as a whole is nearly always certain."""
_FAILED = 1e6
"""Doubt of a failed fit, above any other."""


def doubtful_frames(take: Take) -> IntArray:
    """Return the frames in which the tracker was less sure than usual, the most doubtful one first.

    Each part of the face, and the face as a whole, is compared with its own usual certainty in the take; the worst
    counts. Failed fits come first. Frames near a pin, or near a more doubtful frame, are left out.
    """
    doubt = uncertainty(take)
    starts = np.searchsorted(take.times, take.times - APART, side="right")
    ends = np.searchsorted(take.times, take.times + APART, side="left")
    free = take.found & (doubt > 1.0)
    if (pins := pins_of(take)) and free.any():
        rows, shown = frames_of_pins(take, np.array([pin.time for pin in pins]))
        for frame in np.unique(np.flatnonzero(take.found)[rows[shown]]):
            free[starts[frame] : ends[frame]] = False
    chosen = []
    for frame in np.argsort(-doubt, kind="stable"):
        if free[frame]:
            chosen.append(frame)
            free[starts[frame] : ends[frame]] = False
    return np.array(chosen, dtype=np.intp)


def uncertainty(take: Take) -> FloatArray:
    """Uncertainty relative to the usual one, (N,): the largest of parts and face; 1 where none is known."""
    parts = [take.landmark_confidence[:, part].mean(axis=1) for part in PARTS]
    unsure = 1.0 - np.column_stack([*parts, take.confidence]).astype(np.float64)
    seen = take.found[:, None] & np.isfinite(unsure)
    doubt = np.ones(len(take))
    for values, known in zip(unsure.T, seen.T, strict=True):
        if known.any():
            usual = max(float(np.median(values[known])), _LEAST)
            doubt[known] = np.maximum(doubt[known], values[known] / usual)
    doubt[find_outliers(take)] = _FAILED
    return doubt
