"""Motion at other times than its own: in whole frames of a scene, whatever the rate of its take (method.md, section
9.5), and in between.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..drive.driver import HeadMotion
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from .curves import stops_of

_WHOLE = 1e-6
"""Distance from a whole frame that counts as none."""
_PROMINENCE = 0.1
"""Height of a peak that is kept, as a share of the range of its curve: a blink falls between frames otherwise."""


def whole_frames(frames: FloatArray) -> FloatArray:
    """Return the whole frames (M,) that contain ascending `frames` (N,), from the one before the first of these."""
    return np.arange(np.floor(frames[0] + _WHOLE), np.ceil(frames[-1] - _WHOLE) + 1.0)


def curves_at(frames: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate curves (N, K) at `frames` (N,) to the frames `at` (M,), (M, K).

    Cubics without overshoot lead through the values (Fritsch & Carlson 1980), and what is nearest to a prominent peak
    or valley takes its value, so that eyes and lips that close do so in a frame, however shortly. The first and the
    last value are held.
    """
    values = np.asarray(values, dtype=np.float64)
    inside = np.clip(at, frames[0], frames[-1])
    if len(frames) == 1:
        return np.repeat(values, len(at), axis=0)
    found = np.asarray(linalg.part("interpolate").PchipInterpolator(frames, values)(inside))
    nearest = np.abs(frames[:, None] - at).argmin(axis=1) if len(at) < 2 else _nearest(frames, at)
    for column, curve in zip(found.T, values.T, strict=True):
        stops = stops_of(curve, _PROMINENCE * float(np.ptp(curve)))[1:-1]
        places = nearest[stops]
        around = (column[np.maximum(places - 1, 0)] + column[np.minimum(places + 1, len(at) - 1)]) / 2.0
        # Of several in a frame the last one stays: what the frames around show least.
        order = np.argsort(np.abs(curve[stops] - around), kind="stable")
        column[places[order]] = curve[stops[order]]
    return found


def _nearest(frames: FloatArray, at: FloatArray) -> NDArray[np.intp]:
    """Return the index of the nearest of ascending `at` (M,) for each of `frames` (N,)."""
    after = np.clip(np.searchsorted(at, frames), 1, len(at) - 1)
    return np.asarray(after - (frames - at[after - 1] <= at[after] - frames), dtype=np.intp)


def motion_at(frames: FloatArray, motion: HeadMotion, at: FloatArray) -> HeadMotion:
    """Interpolate a motion at `frames` (N,) to the frames `at` (M,); there are no vertices in the result."""
    turns = np.concatenate([motion.rotation[:, None], motion.jaw[:, None], motion.gaze], axis=1)
    inside = np.clip(at, frames[0], frames[-1])
    turned = np.stack([_turned(frames, part, inside) for part in turns.swapaxes(0, 1)], axis=1)
    return replace(
        motion,
        times=curves_at(frames, motion.times[:, None], at)[:, 0],
        vertices=np.empty((len(at), 0, 3), dtype=np.float32),
        rotation=turned[:, 0],
        jaw=turned[:, 1],
        gaze=turned[:, 2:],
        translation=curves_at(frames, motion.translation, at),
        actions=curves_at(frames, motion.actions, at),
    )


def _turned(frames: FloatArray, rotations: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate rotations (N, 3, 3) on the sphere, (M, 3, 3)."""
    if len(frames) == 1:
        return np.repeat(rotations, len(at), axis=0)
    transform = linalg.part("spatial.transform")
    return np.asarray(transform.Slerp(frames, transform.Rotation.from_matrix(rotations))(at).as_matrix())


def in_between(times: FloatArray, values: FloatArray, at: float) -> FloatArray:
    """Interpolate values (N, ...) linearly at one time between increasing ones; they are constant beyond both ends."""
    after = int(np.searchsorted(times, at, side="left"))
    if after == 0 or after == len(times):
        return np.asarray(values[min(after, len(times) - 1)])
    share = (at - times[after - 1]) / (times[after] - times[after - 1])
    return np.asarray((1.0 - share) * values[after - 1] + share * values[after])
